"""A replayed episode as a CommonRoad scenario [Althoff et al. 2017], in the XML format 2020a.

The file is written here and not by commonroad-io, which pins protobuf to a version that onnx and
newer releases of onnxruntime rule out; a run is replayed with the onnxruntime that it was run with.
CommonRoad's y axis points to the left and its headings are positive to the left.
"""

import itertools
import math
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from charms_bench.episodes.replay import Replay
from charms_bench.foundation.files import check_ending, reject_foreign, write_bytes
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.plan_view import Plan
from charms_bench.world.road import position, width_at
from charms_bench.world.road_network import (
    NO_LINE,
    SOLID,
    SOLID_LINE,
    STRIPED,
    Network,
    roads_after,
)
from charms_bench.world.vehicle_types import TRUCK_LENGTH_M

ENDING = ".xml"
FIRST_VEHICLE = 1001
"""Identifier of the obstacle that is vehicle 0; lanelets are counted from 1."""
FIRST_LATER = 500_000
"""That of the first obstacle that comes to the place of one that has left."""
JUMP_M = 5.0
"""What moves in a step by more than its speed allows and this is another vehicle."""
PLANNING_PROBLEM = 1_000_000
FIRST_SIGN = 2_000_000
SPEED_SIGN = "274"
"""That of a speed limit in CommonRoad's invented country, ZAM; its value is in m/s."""
DATE = "1970-01-01"
"""The format requires a date; with this one, the same episode is always the same file."""
MARGIN_M = 100.0
POINT_DISTANCE_M = 10.0
BEND_DISTANCE_M = 0.5
"""Between the points of the bounds of lanes that can be bent; a circle of 20 m is then 2 mm off."""
TOUCHING_M = 0.5
"""A lane follows another one if it starts at most so far from its end."""
_MARKINGS = {NO_LINE: "no_marking", STRIPED: "dashed", SOLID: "solid", SOLID_LINE: "solid"}


def write_commonroad(replay: Replay, path: Path) -> None:
    """Writes an episode, one time step per simulation step; see `ShownReplay.write_commonroad`."""
    check_ending(path, ENDING)
    reject_foreign(path)
    root = Element(
        "commonRoad",
        commonRoadVersion="2020a",
        benchmarkID=f"ZAM_CharmsBench-{replay.settings.lanes}_{replay.episode + 1}_T-1",
        date=DATE,
        author="charms-bench",
        affiliation="",
        source=f"{replay.cell.title}, episode {replay.episode}",
        timeStepSize=_decimal(1 / replay.settings.simulation_hz),
    )
    # No place on Earth has these coordinates, which CommonRoad uses for an invented road.
    location = SubElement(root, "location")
    for name, value in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        SubElement(location, name).text = value
    tags = SubElement(root, "scenarioTags")
    moving: Replay | Plan = replay
    if replay.plan is None:
        for tag in ("highway", "multi_lane", "no_oncoming_traffic"):
            SubElement(tags, tag)
        SubElement(tags, "simulated")
        _add_lanelets(root, replay)
    else:
        moving = replay.plan
        SubElement(tags, "simulated")
        _add_lanelets_of(root, moving.road, replay.settings.network)
    later = itertools.count(FIRST_LATER)
    for vehicle in np.nonzero(moving.present.any(axis=0))[0].tolist():
        stays = _stays(moving, vehicle, 1 / replay.settings.simulation_hz)
        for k, stay in enumerate(each for each in stays if len(each) > 1):
            number = next(later) if k else FIRST_VEHICLE + vehicle
            _add_vehicle(root, moving, vehicle, stay, number)
    # The planning problem is the ego's start, and as its goal the time when the episode ends.
    problem = SubElement(root, "planningProblem", id=str(PLANNING_PROBLEM))
    _add_state(problem, "initialState", moving, replay.ego, 0)
    time = SubElement(SubElement(problem, "goalState"), "time")
    for name in ("intervalStart", "intervalEnd"):
        SubElement(time, name).text = str(len(replay.t_s) - 1)
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, "utf-8", xml_declaration=True))


def _add_lanelets(root: Element, replay: Replay) -> None:
    lanes, width = replay.settings.lanes, replay.settings.profile.lane_width_m
    x = replay.x[replay.present]
    start, end = x.min() - MARGIN_M, x.max() + MARGIN_M
    along = np.linspace(start, end, int((end - start) // POINT_DISTANCE_M) + 2)
    for lane in range(lanes):
        lanelet = SubElement(root, "lanelet", id=str(lane + 1))
        for name, edge, outer in (("leftBound", -0.5, 0), ("rightBound", 0.5, lanes - 1)):
            bound = SubElement(lanelet, name)
            for x in along:
                _add_point(bound, float(x), (lane + edge) * width)
            SubElement(bound, "lineMarking").text = "solid" if lane == outer else "dashed"
        for name, other in (("adjacentLeft", lane), ("adjacentRight", lane + 2)):
            if 1 <= other <= lanes:
                SubElement(lanelet, name, ref=str(other), drivingDir="same")
        SubElement(lanelet, "laneletType").text = "highway"
        SubElement(lanelet, "userOneWay").text = "vehicle"


def _add_lanelets_of(root: Element, road: Network, named: NamedRoad | None) -> None:
    """The lanes of a network, and signs of their speed limits; lane k is the lanelet k + 1."""
    table = road.lanes
    if named is not None and named.file is not None:
        follows, limits = _in_file(named)
    else:
        follows = [_following(road, lane) for lane in range(table.size)]
        limits = table["speed_limit"].tolist()
    signs = {limit: FIRST_SIGN + k for k, limit in enumerate(dict.fromkeys(filter(None, limits)))}
    for lane, row in enumerate(table):
        lanelet = SubElement(root, "lanelet", id=str(lane + 1))
        steps = max(1, math.ceil(row["length"] / BEND_DISTANCE_M))
        along = np.linspace(0.0, row["length"], steps + 1)
        for name, side in (("leftBound", -0.5), ("rightBound", 0.5)):
            bound = SubElement(lanelet, name)
            for s in along.tolist():
                _add_point(bound, *position(road, lane, s, side * width_at(road, lane, s)))
            line = row["line_left" if side < 0 else "line_right"]
            SubElement(bound, "lineMarking").text = _MARKINGS[line]
        for before in (k for k, each in enumerate(follows) if lane in each):
            SubElement(lanelet, "predecessor", ref=str(before + 1))
        for after in follows[lane]:
            SubElement(lanelet, "successor", ref=str(after + 1))
        for name, other in (("adjacentLeft", row["left"]), ("adjacentRight", row["right"])):
            if other >= 0:
                SubElement(lanelet, name, ref=str(other + 1), drivingDir="same")
        SubElement(lanelet, "laneletType").text = "unknown"
        SubElement(lanelet, "userOneWay").text = "vehicle"
        if limit := limits[lane]:
            SubElement(lanelet, "trafficSignRef", ref=str(signs[limit]))
    for limit, sign in signs.items():
        element = SubElement(root, "trafficSign", id=str(sign))
        inner = SubElement(element, "trafficSignElement")
        SubElement(inner, "trafficSignID").text = SPEED_SIGN
        SubElement(inner, "additionalValue").text = _decimal(limit)
        place = position(road, limits.index(limit), 0.0, 0.0)
        _add_point(SubElement(element, "position"), *place)
        SubElement(element, "virtual").text = "true"


def _in_file(named: NamedRoad) -> tuple[list[list[int]], list[float | None]]:
    """The lanes that follow each lane of a map, and its speed limits; None if it states none."""
    from charms_bench.roads.layout import Layout
    from charms_bench.roads.map_lanes import driven_lanes, indices_of, map_of

    assert named.file is not None
    road = map_of(named.file, str(named.sha256))
    indices = indices_of(road, Layout(driven_lanes(road)))
    follows: list[list[int]] = [[] for _ in indices]
    limits: list[float | None] = [None for _ in indices]
    for lane in road.lanes:
        follows[indices[lane.id]] = [indices[each] for each in lane.successors]
        limits[indices[lane.id]] = lane.speed_limit
    return follows, limits


def _following(road: Network, lane: int) -> list[int]:
    """The lanes that start where a lane ends."""
    row = road.lanes[lane]
    x, y = position(road, lane, row["length"], 0.0)
    roads = roads_after(road, lane)
    lanes = [k for first in roads for k in range(first, first + road.lanes["lanes"][first])]
    starts = {k: position(road, k, 0.0, 0.0) for k in lanes}
    return [k for k, (u, v) in starts.items() if math.hypot(u - x, v - y) <= TOUCHING_M]


def _stays(replay: Replay | Plan, vehicle: int, interval_s: float) -> list[list[int]]:
    """The frames of each vehicle that has the place in turn; an obstacle is never absent.

    One that is there for a single frame has no trajectory, which the format requires.
    """
    frames = np.nonzero(replay.present[:, vehicle])[0]
    x, y, speed = (getattr(replay, name)[frames, vehicle] for name in ("x", "y", "speed"))
    moves = np.hypot(np.diff(x), np.diff(y))
    most = JUMP_M + interval_s * np.maximum(np.abs(speed[1:]), np.abs(speed[:-1]))
    ends = np.nonzero((np.diff(frames) > 1) | (moves > most))[0] + 1
    return [stay.tolist() for stay in np.split(frames, ends)]


def _add_vehicle(
    root: Element, replay: Replay | Plan, vehicle: int, frames: list[int], number: int
) -> None:
    first, *others = frames
    is_obstacle = isinstance(replay, Plan) and bool(replay.is_obstacle[first, vehicle])
    kind = "staticObstacle" if is_obstacle else "dynamicObstacle"
    obstacle = SubElement(root, kind, id=str(number))
    length, width = float(replay.length[first, vehicle]), float(replay.width[first, vehicle])
    of_size = "car" if length < TRUCK_LENGTH_M else "truck"
    SubElement(obstacle, "type").text = "constructionZone" if is_obstacle else of_size
    shape = SubElement(SubElement(obstacle, "shape"), "rectangle")
    SubElement(shape, "length").text = _decimal(length)
    SubElement(shape, "width").text = _decimal(width)
    _add_state(obstacle, "initialState", replay, vehicle, first)
    if is_obstacle:
        return
    trajectory = SubElement(obstacle, "trajectory")
    for frame in others:
        _add_state(trajectory, "state", replay, vehicle, frame)


def _add_state(parent: Element, kind: str, replay: Replay | Plan, vehicle: int, frame: int) -> None:
    state, place = SubElement(parent, kind), (frame, vehicle)
    _add_point(SubElement(state, "position"), replay.x[place], replay.y[place])
    values = {
        "orientation": _decimal(-replay.heading[place]),
        "time": str(frame),
        "velocity": _decimal(replay.speed[place]),
        "acceleration": _decimal(replay.acceleration[place]),
    }
    if kind == "initialState":  # a vehicle starts along the road
        values |= {"yawRate": "0.0", "slipAngle": "0.0"}
    for name, value in values.items():
        SubElement(SubElement(state, name), "exact").text = value


def _add_point(parent: Element, x: float, y: float) -> None:
    point = SubElement(parent, "point")
    SubElement(point, "x").text = _decimal(x)
    SubElement(point, "y").text = _decimal(-y)


def _decimal(value: float) -> str:
    """Returns the shortest decimal that gives this number again; the format has no exponents."""
    return np.format_float_positional(value + 0.0, trim="0")  # + 0.0 turns -0.0 into 0.0
