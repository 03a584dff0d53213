"""A road with several egos gives a row for each of them."""

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from command_line import charms_bench

from charms_bench.api.evaluation import run as run_file
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.metrics.collisions import OF_EGO
from charms_bench.metrics.rows import sums_by_episode
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road
from charms_bench.runs.runner import plan
from charms_bench.runs.shard import simulate
from charms_bench.runs.shard_rows import problem_between
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import estimate, wilson
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import SceneSettings

ROAD = "intersection-multi-agent-v1"
FREE = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
FREE |= {"ego_control_rate": "simulation"}
EPISODES = 4


def driven(ego: int, agent: str = "idm_mobil", traffic: str = PRESCRIBED) -> Simulation:
    """Two scenes, not yet driven, whose rows are those of an ego."""
    settings = SceneSettings.model_validate({"profile": FREE, "decision_hz": 1})
    settings = on_road(settings, NamedRoad(name=ROAD))
    agents = {name: make_agent(name) for name in {agent, traffic} - {PRESCRIBED, ""}}
    simulation = Simulation(settings, 2, agent, OneAgent(traffic), agents, RoadEngine)
    simulation.engine.ego_index = ego
    simulation.reset(np.arange(2, dtype=np.uint64))
    return simulation


@pytest.mark.parametrize(
    ("agent", "traffic"),
    [("idm_mobil", PRESCRIBED), ("human", "human"), ("charms", "human"), ("human", "charms")],
)
def test_both_egos_are_in_the_same_episode(agent: str, traffic: str) -> None:
    one, other = driven(0, agent, traffic), driven(1, agent, traffic)
    assert isinstance(one.engine, RoadEngine)
    assert isinstance(other.engine, RoadEngine)
    for _ in range(6):
        tables = (each.engine.episodes.scenes.vehicles for each in (one, other))
        here, there = (np.stack([table[name] for name in ("x", "y", "speed")]) for table in tables)
        running = one.scene.active & other.scene.active
        assert running.any()
        np.testing.assert_array_equal(here[:, running, 2:], there[:, running, 2:])
        np.testing.assert_array_equal(here[:, running, :2], there[:, running, 1::-1])
        one.step()
        other.step()


def test_several_egos_that_a_program_drives_are_rejected() -> None:
    with pytest.raises(InputError, match="2 egos drive on the road"):
        driven(0, "")


@pytest.fixture(scope="module")
def rows() -> dict[str, pl.DataFrame]:
    suite = {
        "suite": "several",
        "episodes": EPISODES,
        "scene": {"duration_s": 8.0},
        "egos": [{"agent": "idm_mobil"}],
        "roads": [ROAD],
    }
    (task,) = plan(Suite.model_validate(suite)).values()
    return {kind: pl.read_parquet(BytesIO(data)) for kind, data in simulate(task).items()}


def test_each_ego_has_a_row(rows: dict[str, pl.DataFrame]) -> None:
    assert problem_between(rows) == ""
    episodes = rows["episodes"].select("episode", "ego_index").rows()
    assert episodes == [(k, ego) for k in range(EPISODES) for ego in range(2)]
    starts = rows["steps"].filter(step=1).select("ego_index", "x").group_by("ego_index").len()
    assert sorted(starts.rows()) == [(0, EPISODES), (1, EPISODES)]


def test_the_replay_of_an_ego_has_its_rows(tmp_path: Path) -> None:
    path = tmp_path / "several.yaml"
    path.write_text(
        "suite: several\nepisodes: 2\nscene: {duration_s: 6}\negos: [{agent: idm_mobil}]\n"
        "roads: [{name: exit-v1, configuration: {controlled_vehicles: 3, vehicles_count: 6}}]\n"
    )
    made = run_file(path, tmp_path / "run", workers=1)
    shown = made.replay(1, ego_index=2)
    rows = made.steps.filter(episode=1, ego_index=2).drop("ego_index")
    assert shown.steps["x"].to_list() == rows["x"].to_list()
    assert shown.agents[:4] == (*["idm_mobil"] * 3, "IDM of highway-env")
    assert shown.title == "idm_mobil in exit-v1, ego 2"
    ranked = {(case.episode, case.ego_index) for case in made.edge_cases(top=9)}
    assert ranked == {(episode, ego) for episode in range(2) for ego in range(3)}
    with pytest.raises(InputError, match="expected an ego index from 0 to 2, found 3"):
        made.replay(0, ego_index=3)
    other = made.what_if(0, 2, "human", ego_index=1).other
    assert other.agents[:3] == ("human", "idm_mobil", "idm_mobil")


def test_each_ego_of_a_collision_has_its_last_avoidable_moment(tmp_path: Path) -> None:
    path = tmp_path / "several.yaml"
    path.write_text(
        "suite: several\nepisodes: 2\nseed: 37\nscene: {duration_s: 13}\n"
        f"egos: [{{agent: idm_mobil}}]\nroads: [{ROAD}]\ntraffic_models: [{{traffic: human}}]\n"
    )
    made = run_file(path, tmp_path / "run", workers=1)
    crashed = made.episodes.filter(pl.col("ending").is_in(["rear_end", "side"]))
    expected = {*crashed.select("episode", "ego_index").iter_rows()}
    assert {ego for _, ego in expected} == {0, 1}
    out = charms_bench("edge-cases", tmp_path / "run", "--avoidable", "--budget", "50", "--json")
    found = json.loads(out.stdout)
    assert {(each["episode"], each["ego_index"]) for each in found} == expected


def test_sums_are_those_of_both_egos_by_episode(rows: dict[str, pl.DataFrame]) -> None:
    of_all = (OF_EGO, rows["episodes"], rows["steps"], SceneSettings(decision_hz=3))
    crashed = sums_by_episode(*of_all, rows["drivers"])[0]
    has_crashed = rows["episodes"]["ending"].is_in(["rear_end", "side", "off_road"]).to_numpy()
    assert crashed[:, 0].tolist() == [2.0] * EPISODES
    assert crashed[:, 1].tolist() == has_crashed.reshape(EPISODES, 2).sum(axis=1).tolist()


def test_intervals_are_those_of_episodes_whose_egos_crash_together() -> None:
    # With both egos or none, 40 episodes say no more than 40 trials; of Student's t, a bit less.
    both = np.repeat([[2.0, 2.0], [2.0, 0.0]], 20, axis=0)
    (found,) = estimate(OF_EGO[:1], [both], seed=0)
    low, high = wilson(20, 40)
    assert found.value == 0.5
    assert 0.9 * (high - low) < found.high - found.low < 1.2 * (high - low)
