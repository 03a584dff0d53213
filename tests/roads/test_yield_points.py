"""Where lanes of maps meet, and who goes first there."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from charms_bench.maps.reading import read_road
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.road_from_file import FileRoad
from charms_bench.roads.scenes import IDM, place
from charms_bench.roads.stepping import decide
from charms_bench.roads.yield_points import Meetings, meetings_of
from charms_bench.world.named_road import FILE_ROAD, NamedRoad

NOBODY = np.zeros((1, 0), dtype=np.int64)


def straight(name: str, start: list[float], end: list[float], *after: str) -> dict[str, Any]:
    lane = {"id": name, "kind": "straight", "start": start, "end": end, "width": 3.0}
    return {**lane, "speed_limit": 10.0, "successors": [*after]}


def road_of(start: str, end: str, *lanes: dict[str, Any], junction: str = "") -> dict[str, Any]:
    return {"start": start, "end": end, "lanes": [*lanes], "junction": junction}


def written(tmp_path: Path, roads: list[dict[str, Any]], **more: Any) -> Path:
    path = tmp_path / "road.json"
    path.write_text(json.dumps({"charms_bench_road": 1, "roads": roads, **more}))
    return path


def meetings(path: Path) -> Meetings:
    road = read_road(path)
    return meetings_of(road, {lane.id: k for k, lane in enumerate(road.lanes)})


def driving(path: Path, vehicles: int) -> tuple[Episodes, FileRoad]:
    road = NamedRoad.model_validate({"file": path})
    lane_km = sum(lane.length for lane in read_road(path).lanes) / 1000
    density = (vehicles - 1) / lane_km
    config = {"file": str(path), "sha256": road.sha256, "density": density}
    episodes = Episodes(FILE_ROAD, 1, config)
    assert isinstance(episodes.task, FileRoad)
    episodes.seed(episodes.everyone, np.zeros(1, dtype=np.uint64))
    episodes.start(episodes.everyone)
    episodes.task.release_egos(episodes.scenes)
    return episodes, episodes.task


def test_a_place_where_lanes_meet_begins_on_the_part_of_the_lane_before(tmp_path: Path) -> None:
    ends = [("in", 0, 50, ""), ("first", 50, 60, "J"), ("second", 60, 80, "J")]
    roads = [
        {
            "start": name,
            "end": after,
            "junction": junction,
            "lanes": [
                {"id": name, "kind": "straight", "start": [x, 0], "end": [end, 0]}
                | ({"successors": [after]} if after != "end" else {})
            ],
        }
        for (name, x, end, junction), after in zip(ends, ("first", "second", "end"), strict=True)
    ]
    across = {"id": "across", "kind": "straight", "start": [55, -3], "end": [75, 3]}
    roads.append({"start": "s", "end": "t", "junction": "J", "lanes": [across]})
    meet = {"lanes": ["second", "across"], "at": [5, 10.44], "kind": "crossing"}
    path = tmp_path / "road.json"
    path.write_text(json.dumps({"charms_bench_road": 1, "roads": roads, "conflicts": [meet]}))
    road = read_road(path)
    found = meetings_of(road, {lane.id: k for k, lane in enumerate(road.lanes)})
    # At x = 54 m, the start of the other lane is hypot(1, 3) = 3.16 m away, at 53.5 m 3.35 m, and
    # lanes are close below 3.2 m. A centre stays 1.5 m away: from 52.5 m on, 7.5 m before "second".
    assert found.begins[found.other == 3].tolist() == [-7.5]


@pytest.mark.parametrize(("apart", "begins"), [(2.0, [-1.5]), (3.0, [])])
def test_opposite_lanes_of_a_junction_meet_where_vehicles_have_no_room_beside_each_other(
    tmp_path: Path, apart: float, begins: list[float]
) -> None:
    there, back = straight("there", [0, 0], [20, 0]), straight("back", [20, -apart], [0, -apart])
    path = written(
        tmp_path, [road_of("a", "b", there, junction="J"), road_of("c", "d", back, junction="J")]
    )
    # Closer than 2.5 m along all of their 20 m, and a centre stays 1.5 m away.
    assert meetings(path).begins[:1].tolist() == begins


@pytest.mark.parametrize(("radius", "count"), [(5.4, 2), (20.0, 0)])
def test_opposite_lanes_3_5_m_apart_meet_in_sharp_turns(
    tmp_path: Path, radius: float, count: int
) -> None:
    # 2.5 m, and 4 m2 times the curvatures: 4 (1/5.4 + 1/8.9) = 1.19 m, or 4 (1/20 + 1/23.5) =
    # 0.37 m.
    arc = {"kind": "circular", "center": [0, 0], "width": 3.5}
    inner = {**arc, "id": "in", "radius": radius, "start_phase": 0, "end_phase": math.pi / 2}
    outer = {**arc, "id": "out", "radius": radius + 3.5, "start_phase": math.pi / 2, "end_phase": 0}
    lanes = {**inner, "clockwise": True}, {**outer, "clockwise": False}
    roads = [road_of(f"a{k}", f"b{k}", lane, junction="J") for k, lane in enumerate(lanes)]
    assert meetings(written(tmp_path, roads)).other.size == count


WAYS = {"w": (1, 0), "n": (0, 1), "e": (-1, 0), "s": (0, -1)}
"""The directions of four ways over a crossing, each of which keeps 2 m to the right."""


@pytest.mark.parametrize("is_ring", [False, True])
def test_four_vehicles_that_come_together_all_get_over_a_crossing(
    tmp_path: Path, is_ring: bool
) -> None:
    roads, conflicts, names = [], [], [*WAYS]
    for name, (x, y) in WAYS.items():
        at = [[s * x - 2 * y, s * y + 2 * x] for s in (-60, -8, 8, 60)]
        to, over, off = f"to-{name}", f"over-{name}", f"off-{name}"
        roads += [
            road_of(f"{name}0", f"{name}1", straight(to, at[0], at[1], over)),
            road_of(f"{name}1", f"{name}2", straight(over, at[1], at[2], off), junction="J"),
            road_of(f"{name}2", f"{name}3", straight(off, at[2], at[3])),
        ]
    for k, name in enumerate(names):
        # A way crosses that from its left after 6 m, which is 10 m along the other one.
        pair = [f"over-{name}", f"over-{names[k - 3]}"]
        conflict = {"lanes": pair, "at": [6, 10], "kind": "crossing"}
        conflicts.append(conflict | ({"gives_way": pair[0]} if is_ring else {}))
    episodes, task = driving(written(tmp_path, roads, conflicts=conflicts), 4)
    scenes, table = episodes.scenes, episodes.scenes.vehicles[0]
    for i, (x, y) in enumerate(WAYS.values()):
        place(scenes, 0, i, IDM, -30 * x - 2 * y, -30 * y + 2 * x, math.atan2(y, x), 8.0)
    task.open_ends()
    task.follow(scenes, episodes.everyone)
    for _ in range(5 * 60):
        decide(scenes, episodes.everyone, NOBODY, 3, 0.2)
        assert not table["crashed"].any()
        task.follow(scenes, episodes.everyone)
    assert not (table["kind"] == IDM).any()


def test_oncoming_vehicles_on_close_lanes_pass_each_other(tmp_path: Path) -> None:
    there, back = straight("there", [0, 0], [300, 0]), straight("back", [300, -2.45], [0, -2.45])
    path = written(tmp_path, [road_of("a", "b", there), road_of("c", "d", back)])
    episodes, _ = driving(path, 2)
    scenes, table = episodes.scenes, episodes.scenes.vehicles[0]
    place(scenes, 0, 0, IDM, 100.0, 0.0, 0.0, 10.0)
    place(scenes, 0, 1, IDM, 200.0, -2.45, math.pi, 10.0)
    for _ in range(5 * 8):
        decide(scenes, episodes.everyone, NOBODY, 3, 0.2)
    assert not table["crashed"].any()
    assert table["x"][0] - 100.0 > 70.0
    assert 200.0 - table["x"][1] > 70.0


def test_a_vehicle_stops_before_a_lane_that_ends_is_too_narrow(tmp_path: Path) -> None:
    left = straight("left", [0, 0], [100, 0], "on")
    narrows = {"x": [0, 100], "y": [3.5, 2.0], "width": [4.0, 0.0]}
    right = {"id": "right", "kind": "polyline", "speed_limit": 10.0, **narrows}
    on = straight("on", [100, 0], [200, 0])
    path = written(tmp_path, [road_of("a", "b", left, right), road_of("b", "c", on)])
    episodes, task = driving(path, 2)
    place(episodes.scenes, 0, 0, IDM, 5.0, 3.4, 0.0, 5.0)
    task.follow(episodes.scenes, episodes.everyone)
    # It is 2.5 m wide after 37.5 m, and a centre stops 4 m before.
    assert episodes.scenes.vehicles["stop_s"][0, 0] == pytest.approx(33.5, abs=1.0)
