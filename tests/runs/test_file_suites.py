"""Suites on roads in files: tables, audits, replays, and files that change."""

from pathlib import Path

import numpy as np
import pytest

from charms_bench.api import open_run
from charms_bench.api.evaluation import run as run_file
from charms_bench.errors import SuiteError
from charms_bench.maps.joining import joined
from charms_bench.maps.reading import read_road
from charms_bench.maps.road_map import RoadMap
from charms_bench.runs.suite import load_suite

PLACES = Path(__file__).parents[2] / "suites" / "places"
TEXT = """
suite: own-road
episodes: 3
scene:
  profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}
  duration_s: 20.0
egos: [{agent: idm_mobil}, {agent: charms}]
roads: [{file: roads/mine.json, label: mine, configuration: {density: 8}}]
traffic_models: [{traffic: environment}, {traffic: idm_mobil}]
"""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    (tmp_path / "roads").mkdir()
    (tmp_path / "roads" / "mine.json").write_bytes((PLACES / "motorway.json").read_bytes())
    (tmp_path / "own.yaml").write_text(TEXT)
    return tmp_path / "own.yaml"


def test_a_run_on_a_file_has_tables_and_can_be_audited_and_replayed(
    suite: Path, tmp_path: Path
) -> None:
    run_file(suite, tmp_path / "run", workers=1)
    (suite.parent / "roads" / "mine.json").unlink()  # the folder has a copy
    found = open_run((tmp_path / "run").rename(tmp_path / "moved"))
    rows = found.table.records()
    assert [row["road"] for row in rows] == ["mine"] * 4
    assert all(0.0 <= row["goal_reached"] <= 1.0 for row in rows)
    assert found.audit(shards=1, workers=1).verdict == "pass"
    replay = found.replay(0, ego="idm_mobil", traffic="environment")
    replay.write_commonroad(tmp_path / "episode.xml")
    assert_same_lanes(joined(read_road(PLACES / "motorway.json")), tmp_path / "episode.xml")


def assert_same_lanes(road: RoadMap, scenario: Path) -> None:
    """Asserts that a scenario has the ends, speed limits and successors of lanes."""
    written = {lane.id: lane for lane in read_road(scenario).lanes}
    found = [*written.values()]
    names = {}
    for lane in road.lanes:
        ends = [
            np.hypot(*(each.points[[0, -1], :2] - lane.points[[0, -1], :2]).T) for each in found
        ]
        near = int(np.argmin([each.max() for each in ends]))
        assert ends[near].max() < 0.01, lane.id
        names[lane.id] = found[near].id
    assert sorted(names.values()) == sorted(written)
    for lane in road.lanes:
        other = written[names[lane.id]]
        assert other.speed_limit == pytest.approx(lane.speed_limit)
        assert {*other.successors} == {names[each] for each in lane.successors}


def test_a_changed_file_is_another_suite(suite: Path) -> None:
    before = load_suite(suite)
    road = suite.parent / "roads" / "mine.json"
    road.write_text(road.read_text(encoding="utf-8").replace("33.3", "27.8"), encoding="utf-8")
    assert load_suite(suite).fingerprint() != before.fingerprint()


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ("{file: none.json}", r"own\.yaml:\d+: roads\[0\]: .*none\.json: cannot be read: No such"),
        ("{file: own.yaml}", r"own\.yaml: line 2: not XML"),
        (
            "{file: roads/mine.json, configuration: {lanes: 3}}",
            "configuration: no key named 'lanes'",
        ),
        ("{file: roads/mine.json, configuration: {density: 1000}}", "expected 0 to 2,000"),
        ("{file: roads/mine.json, configuration: {file: x}}", "give file beside the configuration"),
    ],
)
def test_a_file_that_cannot_be_driven_on_is_one_message(suite: Path, given: str, what: str) -> None:
    text = TEXT.replace("{file: roads/mine.json, label: mine, configuration: {density: 8}}", given)
    suite.write_text(text)
    with pytest.raises(SuiteError, match=what):
        load_suite(suite)
