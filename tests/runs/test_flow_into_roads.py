"""Suites with types of vehicles that flow into an exit and a map."""

from pathlib import Path
from typing import Any

import pytest

from charms_bench.api.evaluation import run as run_file

MOTORWAY = Path(__file__).parents[2] / "suites" / "places" / "motorway.json"
TEXT = f"""
suite: flow
episodes: 4
scene:
  duration_s: 6.0
  inflow: {{vehicles_per_hour_and_lane: 1200, capacity: 60}}
  vehicle_types:
    - {{name: car, proportion: 0.7}}
    - {{name: truck, proportion: 0.3, length_m: 14.0, desired_speed_mps: [10, 12]}}
  ego_type: truck
egos: [{{agent: idm_mobil}}]
roads: [exit-v1, {{file: "{MOTORWAY}", configuration: {{density: 4}}}}]
traffic_models: [{{traffic: environment}}, {{traffic: {{mixture: {{human: 0.5, idm_mobil: 0.5}}}}}}]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("flow") / "flow.yaml"
    path.write_text(TEXT)
    return run_file(path, path.parent / "run", workers=1)


def test_rows_are_the_same_with_two_workers_and_after_an_interruption(
    made: Any, tmp_path: Path
) -> None:
    suite = made.path.parent / "flow.yaml"
    again = run_file(suite, tmp_path / "again", workers=2)
    for path in sorted((again.path / "checksums").iterdir())[::2]:
        path.unlink()  # as if these shards had not been finished
    run_file(suite, tmp_path / "again", workers=1)
    files = sorted(path.relative_to(made.path) for path in made.path.glob("*/*.parquet"))
    assert len(files) >= 4 * 4
    for name in files:
        assert (made.path / name).read_bytes() == (again.path / name).read_bytes(), name


def test_vehicles_that_flow_in_are_part_of_the_traffic(made: Any) -> None:
    # At the start, 20 vehicles are on the exit; 6 lanes x 1200 per hour x 6 s are 12 more.
    rows = made.episodes.filter(road="exit-v1")
    assert (rows["traffic_vehicles"] > 20).all()


def test_an_audit_simulates_them_again(made: Any) -> None:
    assert made.audit(shards=None, workers=1).verdict == "pass"


def test_a_replay_shows_them(made: Any) -> None:
    replay = made.replay(0, ego="idm_mobil", road="motorway", traffic="environment")
    assert replay.plan.present[-1].sum() > replay.plan.present[0].sum()
