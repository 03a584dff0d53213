"""Suites on roads where vehicles come and go, drive in circles or towards each other."""

import shutil
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from run_folders import sign

from charms_bench.api import open_run
from charms_bench.api.evaluation import run as run_file
from charms_bench.roads import OF_SUITES, TASKS

TEXT = """
suite: small-roads
episodes: 4
scene:
  profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}
egos: [{agent: idm_mobil}, {agent: charms}]
roads:
  - {name: highway-fast-v0, configuration: {vehicles_count: 8}, duration_s: 6.0}
  - {name: two-way-v0, duration_s: 6.0}
  - {name: racetrack-oval-v1, configuration: {length: 60, other_vehicles: 2}, duration_s: 60.0}
  - intersection-v2
traffic_models: [{traffic: environment}, {traffic: {mixture: {human: 0.5, charms: 0.5}}}]
columns: [goal_reached, time_to_goal, crashed_episodes]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("roads")
    path = folder / "roads.yaml"
    path.write_text(TEXT)
    return run_file(path, folder / "run", workers=1)


def test_every_road_with_traffic_and_one_ego_is_in_suites() -> None:
    # A car park has spots and no traffic, and nobody else is on a winding lane.
    without = {each for each in TASKS if each.startswith(("parking", "lane-keeping"))}
    several = {each for each in TASKS if "multi-agent" in each}
    assert set(OF_SUITES) == set(TASKS) - without - several
    assert len(OF_SUITES) == 24


def test_an_audit_simulates_rows_again_and_finds_a_forged_one(made: Any, tmp_path: Path) -> None:
    assert made.audit(shards=1, workers=1).verdict == "pass"
    forged = open_run(Path(shutil.copytree(made.path, tmp_path / "run")))
    name = next(path for path in sorted((forged.path / "episodes").glob("003-*.parquet")))
    rows = pl.read_parquet(name)  # of the intersection with its own vehicles
    rows.with_columns(distance_m=pl.col("distance_m") + 0.5).write_parquet(name)
    sign(forged.path, name.stem)
    findings = [
        each for each in forged.audit(shards=None, workers=1).findings if each.check == "rows"
    ]
    assert [each.where for each in findings] == [f"episodes/{name.name}", ""]
    assert findings[1].what.startswith("1 of 16 shards that were simulated again differ")


def test_only_a_motorway_has_no_goal(made: Any) -> None:
    rows = made.episodes
    assert not rows.filter(road="highway-fast-v0")["has_goal"].any()
    assert rows.filter(pl.col("road") != "highway-fast-v0")["has_goal"].all()
    table = made.table.frame().filter(metric="goal_reached")
    assert table.filter(road="highway-fast-v0")["value"].is_null().all()
    assert table.filter(pl.col("road") != "highway-fast-v0")["value"].is_not_null().all()
    assert table.filter(road="racetrack-oval-v1", agent="idm_mobil")["value"].max() == 1.0


def test_how_a_collision_at_an_intersection_could_be_avoided_is_searched(made: Any) -> None:
    crashed = made.episodes.filter(pl.col("ending").is_in(["rear_end", "side"]))
    expected = crashed.filter(road="intersection-v2").height
    found = made.avoidability(road="intersection-v2", budget=60)
    assert len(found) == expected > 0
    assert {each.road for each in found} == {"intersection-v2"}


def test_a_replay_of_an_intersection_has_the_vehicles_that_enter(made: Any, tmp_path: Path) -> None:
    lasting = made.episodes.filter(agent="idm_mobil", road="intersection-v2").sort("steps")[-1]
    cell = {"ego": "idm_mobil", "road": "intersection-v2", "traffic": lasting["traffic"][0]}
    replay = made.replay(lasting["episode"][0], **cell)
    first, last = replay.plan.present[0].sum(), replay.plan.present.sum(axis=1).max()
    assert last > first
    replay.animate(tmp_path / "intersection.gif")
    assert (tmp_path / "intersection.gif").stat().st_size > 10_000
