"""The probability of a rare event on a road whose vehicles also come during the episode."""

from pathlib import Path

import numpy as np
import pytest
from command_line import charms_bench

from charms_bench import api
from charms_bench.engine.draws import count_of
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.runs.shard import engine_on
from charms_bench.runs.suite import Cell, load_suite

SUITE = """\
suite: junction
episodes: 2
scene: {profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}}
egos: [{agent: idm_mobil, label: IDM}]
roads:
  - {name: intersection-v1, duration_s: 4.0, configuration: {spawn_probability: 0.4}}
  - {name: merge-v1, duration_s: 2.0}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> api.Rare:
    path = tmp_path_factory.mktemp("rare") / "junction.yaml"
    path.write_text(SUITE, encoding="utf-8")
    return api.rare(path, "crash", path.parent / "out", runs=5, samples=200, workers=1)


def simulation(cell: Cell, scenes: int) -> Simulation:
    agents = {"idm_mobil": make_agent("idm_mobil")}
    traffic = cell.traffic.traffic.make()
    return Simulation(cell.scene, scenes, "idm_mobil", traffic, agents, engine_on(cell.scene))


def test_the_proportion_of_plain_episodes_is_in_the_interval(made: api.Rare) -> None:
    cell = load_suite(made.path.parent / "junction.yaml").cells[0]
    plain = simulation(cell, 3000)
    plain.reset(np.arange(3000, dtype=np.uint64))
    while plain.scene.active.any():
        plain.step()
    row = next(row for row in made.table.rows if row.labels[1] == "intersection-v1")
    number = row.numbers[0]
    assert 0.0 < number.low < plain.failed.mean() < number.high < 0.1


def test_the_suite_needs_no_episodes(tmp_path: Path) -> None:
    path = tmp_path / "junction.yaml"
    path.write_text(SUITE.replace("episodes: 2\n", ""), encoding="utf-8")
    with pytest.raises(InputError, match="runs is 1; expected 5 to"):  # what is checked next
        api.rare(path, output=tmp_path / "out", runs=1)


def test_the_table_names_the_road_and_show_prints_it_again(made: api.Rare) -> None:
    assert [row.labels for row in made.table.rows] == [
        ("IDM", "intersection-v1", "environment"),
        ("IDM", "merge-v1", "environment"),
    ]
    assert {*made.runs["road"]} == {"intersection-v1", "merge-v1"}
    assert "intersection-v1" in charms_bench("show", made.path).stdout


def test_draws_during_the_episode_are_among_those_given(made: api.Rare) -> None:
    cell = load_suite(made.path.parent / "junction.yaml").cells[0]
    one, other = simulation(cell, 1), simulation(cell, 1)
    draws = np.random.default_rng(3).standard_normal((1, count_of(cell.scene)))
    seeds = np.array([5], dtype=np.uint64)
    one.reset(seeds, draws=draws)
    taken = int(one.engine.state.generator[0, 6])
    assert 0 < taken < draws.size
    changed = draws.copy()
    changed[0, taken:] = -changed[0, taken:]
    other.reset(seeds, draws=changed)
    assert one.state() == other.state()
    for _ in range(6):
        one.step()
        other.step()
    assert one.state() != other.state()
