"""Suites whose vehicles come and go: replays and metrics tell them apart."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from pydantic import ValidationError

from charms_bench.api.evaluation import run as run_file
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.errors import InputError
from charms_bench.humans.population import read_population
from charms_bench.runs.likeness import standard
from charms_bench.runs.suite import Suite
from charms_bench.world.scene import SceneSettings

TEXT = """
suite: small-open
episodes: 2
scene:
  profile: {name: naturalistic, road_length_m: 700.0}
  lanes: 2
  traffic_vehicles: 4
  ego_slots: 1
  duration_s: 40.0
  inflow: {vehicles_per_hour_and_lane: 1400, capacity: 16}
  vehicle_types:
    - {name: car, proportion: 0.5}
    - {name: truck, proportion: 0.5, length_m: 15.0, width_m: 2.5, desired_speed_mps: [20, 22]}
egos: [{agent: idm_mobil}]
traffic_models: [{traffic: {mixture: {idm_mobil: 0.5, stackelberg: 0.5}}, label: both}]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("open")
    (folder / "open.yaml").write_text(TEXT)
    return run_file(folder / "open.yaml", folder / "run", workers=1)


@pytest.mark.parametrize("episode", [0, 1])
def test_a_replay_has_every_vehicle_that_has_been_there_once(made: Any, episode: int) -> None:
    replay = made.replay(episode)
    row = made.episodes.filter(episode=episode).row(0, named=True)
    rows = replay.trajectories().sort("vehicle", "t_s")
    assert rows["vehicle"].n_unique() == row["traffic_vehicles"] + 1 > 5 + 16 / 2
    assert rows["vehicle"].unique().sort().to_list() == list(range(len(replay.agents)))
    assert rows.filter("ego")["vehicle"].unique().to_list() == [replay.ego]
    moves = rows.select(pl.col("x").diff().over("vehicle")).to_series()
    assert (moves.drop_nulls() >= 0).all()
    for name in ("length", "width", "agent"):
        assert rows.group_by("vehicle").agg(pl.col(name).n_unique())[name].to_list() == [1] * len(
            replay.agents
        )
    first = rows.group_by("vehicle", maintain_order=True).agg(pl.col("t_s").min())
    assert first["t_s"].is_sorted()
    np.testing.assert_array_equal(replay.length.min(axis=0), replay.length.max(axis=0))


def test_the_mean_speed_of_the_traffic_counts_the_time_that_it_was_there(made: Any) -> None:
    rows = pl.concat(made.replay(episode).trajectories() for episode in (0, 1))
    speed = rows.filter(~pl.col("ego"))["speed"].mean()
    found = made.table.frame().filter(pl.col("metric") == "traffic_speed_mean")
    value = found["value"].item()
    assert value == pytest.approx(speed, rel=0.01)


def test_another_agent_takes_over_a_vehicle_that_has_entered(made: Any) -> None:
    recorded = made.replay(0)
    vehicle = len(recorded.agents) - 6
    assert not recorded.present[0, vehicle]
    step = int(recorded.present[:, vehicle].argmax()) // recorded.frame_of(1) + 3
    found = made.what_if(0, step, agent="level_0", vehicle=vehicle)
    assert found.other.agents[vehicle] == "level_0"
    start = found.start + 1
    both = slice(None, min(recorded.x.shape[1], found.other.x.shape[1]))
    np.testing.assert_array_equal(recorded.x[:start, both], found.other.x[:start, both])
    (mine, others) = found.futures()[-1]
    assert (mine.vehicle, others.vehicle) == (vehicle, vehicle)
    assert others.agent == "level_0"


@pytest.mark.parametrize(
    ("key", "where"),
    [("network", "suite's `roads`"), ("road", "suite's `roads`"), ("scenario", "a traffic model")],
)
def test_what_a_cell_decides_is_no_key_of_a_scene(key: str, where: str) -> None:
    with pytest.raises(ValidationError, match=where):
        SceneSettings.model_validate({key: "roundabout-v0"})


SCENARIO = {"ego": {"lane": 0, "speed_mps": 12}, "vehicles": [
    {"name": "a", "lane": 1, "x_m": 9, "speed_mps": 12}]}  # fmt: skip
INFLOW = {"inflow": {"vehicles_per_hour_and_lane": 900, "capacity": 9}}


def suite(traffic: Any, **scene: Any) -> Suite:
    return Suite.model_validate({
        "suite": "s", "episodes": 1, "scene": scene, "egos": [{"agent": "idm_mobil"}],
        "traffic_models": [{"traffic": traffic, "label": "t"}],
    })  # fmt: skip


def test_a_scenario_and_an_inflow_exclude_each_other() -> None:
    with pytest.raises(ValidationError, match=r"places all vehicles; remove scene\.inflow"):
        suite({"scenario": SCENARIO}, **INFLOW)


@pytest.mark.parametrize(
    "of", [lambda: suite("idm_mobil", **INFLOW), lambda: suite({"scenario": SCENARIO})]
)
def test_likeness_places_the_vehicles_itself(of: Callable[[], Suite], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a suite without scene\.recording, scene\.inf"):
        standard(of(), tmp_path, read_population("i75"))


def test_vehicles_that_come_and_go_are_no_learners() -> None:
    with pytest.raises(InputError, match="vehicles that enter need a driver"):
        LearnersVectorEnv(1, None, **INFLOW)
