"""Short roads that only follow each other are joined."""

import json
from pathlib import Path
from typing import Any

import pytest

from charms_bench.maps.joining import joined
from charms_bench.maps.reading import read_road
from charms_bench.maps.road_map import RoadMap


def lane(name: str, start: float, end: float, *after: str, y: float = 0.0) -> dict[str, Any]:
    ends = {"start": [start, y], "end": [end, y]}
    return {"id": name, "kind": "straight", **ends, "successors": list(after)}


def road_of(folder: Path, **more: Any) -> RoadMap:
    """Roads of 100, 5 and 20 m after each other, and then a fork."""
    roads = [
        {"start": "a", "end": "b", "lanes": [lane("one", 0, 100, "two")]},
        {"start": "b", "end": "c", "lanes": [lane("two", 100, 105, "three")]},
        {"start": "c", "end": "d", "lanes": [lane("three", 105, 125, "four", "five")]},
        {"start": "d", "end": "e", "lanes": [lane("four", 125, 135)]},
        {"start": "d", "end": "f", "lanes": [lane("five", 125, 145)]},
    ]
    path = folder / "road.json"
    path.write_text(json.dumps({"charms_bench_road": 1, "roads": roads, **more}))
    return joined(read_road(path))


def test_roads_are_joined_up_to_a_fork(tmp_path: Path) -> None:
    road = road_of(tmp_path)
    lengths = {lane.id: lane.length for lane in road.lanes}
    assert lengths == pytest.approx({"one": 125.0, "four": 10.0, "five": 20.0})
    (whole,) = (lane for lane in road.lanes if lane.id == "one")
    assert whole.successors == ("four", "five")


def test_a_conflict_keeps_its_place(tmp_path: Path) -> None:
    conflict = {"lanes": ["two", "five"], "at": [2.0, 3.0], "kind": "crossing", "gives_way": "two"}
    (found,) = road_of(tmp_path, conflicts=[conflict]).conflicts
    assert (found.lanes, found.at, found.gives_way) == (("one", "five"), (102.0, 3.0), "one")


def test_a_light_stays_at_the_end_of_its_lane(tmp_path: Path) -> None:
    light = {"id": "l", "kind": "light", "x": 105, "y": 0, "lanes": ["two"]}
    road = road_of(tmp_path, signals=[light])
    assert [lane.id for lane in road.lanes][:2] == ["one", "three"]
    assert road.signals[0].lanes == ("one",)
