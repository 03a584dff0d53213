"""Networks of lanes of any kind: the table of lanes, and the rules of `world.road` for them."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled, wrap_to_pi
from charms_bench.world.lane_geometry import (
    CIRCULAR,
    CURVE,
    END_MARGIN_M,
    POLYLINE,
    SINE,
    STRAIGHT,
    Curves,
    Pair,
    curve_coordinates,
    curve_heading,
    curve_position,
    curve_width,
    line_coordinates,
    line_heading,
    line_position,
)

NO_LINE, STRIPED, SOLID, SOLID_LINE = range(4)
"""Kinds of lines beside lanes; the last two are drawn alike [`LineType`]."""
_FLOATS = (
    "x y direction_x direction_y heading length width speed_limit amplitude pulsation phase "
    "radius start_phase turn"
)
_INTEGERS = (
    "kind forbidden priority line_left line_right left right first lanes next_roads next_count "
    "curve point_count pose_count width_count level"
)
_FIELDS = {"f8": _FLOATS, "i8": _INTEGERS}
LANE = np.dtype(
    (np.record, [(name, kind) for kind, names in _FIELDS.items() for name in names.split()])
)
"""A row of the table of lanes. `x` and `y` are the lane's start, or the centre of a circular lane,
whose `turn` is 1 if it is clockwise and -1 otherwise. `left` and `right` are the neighbours, -1
for none. `first` is the first lane of the same road between two nodes, and `lanes` their number;
`next_roads` and `next_count` are a part of `Network.successors`. A polyline has so many points,
poses and widths in `Network.curves`, from the row `curve` on. Lanes of different levels cross above
each other; 0 is that of all others, which is not apart from any."""


class Network(NamedTuple):
    """Lanes in the order in which highway-env lists them [`RoadNetwork.lanes_list`]."""

    lanes: NDArray[np.void]
    """[L] rows of `LANE`."""
    curves: Curves
    """[K] rows of `lane_geometry.CURVE`: the polylines, one after the other."""
    successors: NDArray[np.int64]
    """The first lanes of the roads that start where another road ends."""


@dataclass(frozen=True, kw_only=True)
class _Lane:
    """What all lanes have; units are SI, and names and defaults are those of highway-env."""

    width: float = 4.0
    speed_limit: float = 20.0
    forbidden: bool = False
    priority: int = 0
    line_types: tuple[int, int] = (STRIPED, STRIPED)
    """The lines on the left and on the right."""


@dataclass(frozen=True, kw_only=True)
class StraightLane(_Lane):
    """A lane from one point to another."""

    start: Pair
    end: Pair


@dataclass(frozen=True, kw_only=True)
class SineLane(StraightLane):
    """A lane that swings about the line from one point to another."""

    amplitude: float
    pulsation: float
    """rad/m."""
    phase: float


@dataclass(frozen=True, kw_only=True)
class CircularLane(_Lane):
    """An arc; phases are the angles of its points as seen from its centre, rad."""

    center: Pair
    radius: float
    start_phase: float
    end_phase: float
    clockwise: bool = True


@dataclass(frozen=True, kw_only=True)
class PolyLane(_Lane):
    """A lane along points, at least 1 m long [`PolyLaneFixedWidth`]."""

    points: tuple[Pair, ...]
    widths: tuple[float, ...] = ()
    """The width at each metre; empty if it is `width` everywhere [`PolyLane`]."""


Lane = StraightLane | SineLane | CircularLane | PolyLane


def network_of(lanes: Iterable[tuple[str, str, Lane]]) -> Network:
    """The network of lanes, each with the names of the nodes at its start and its end.

    The lanes come in the order of highway-env's calls of `RoadNetwork.add_lane`.
    """
    graph: dict[str, dict[str, list[Lane]]] = {}
    for start, end, lane in lanes:
        graph.setdefault(start, {}).setdefault(end, []).append(lane)
    roads = [(start, end, road) for start, ends in graph.items() for end, road in ends.items()]
    firsts = np.cumsum([0, *(len(road) for _, _, road in roads)]).tolist()
    first_of = {(start, end): first for (start, end, _), first in zip(roads, firsts, strict=False)}
    table = np.zeros(firsts[-1], LANE)
    curves, points = [np.zeros(0, CURVE)], 0
    successors: list[int] = []
    for start, end, road in roads:
        first = first_of[start, end]
        following = [first_of[end, after] for after in graph.get(end, {})]
        for k, lane in enumerate(road):
            row = table[first + k]
            _describe(row, lane)
            row["left"] = first + k - 1 if k else -1
            row["right"] = first + k + 1 if k + 1 < len(road) else -1
            row["first"], row["lanes"] = first, len(road)
            row["next_roads"], row["next_count"] = len(successors), len(following)
            if isinstance(lane, PolyLane):
                row["curve"] = points
                curves.append(_trace(row, lane))
                points += len(curves[-1])
        successors += following
    return Network(table, np.concatenate(curves), np.array(successors, dtype=np.int64))


def roads_after(road: Network, lane: int) -> list[int]:
    """The first lanes of the roads that start where a lane ends."""
    row = road.lanes[lane]
    return [int(each) for each in road.successors[row["next_roads"] :][: row["next_count"]]]


def _describe(row: Any, lane: Lane) -> None:
    """Fills the row of a lane but for what depends on other lanes or on a polyline."""
    row["line_left"], row["line_right"] = lane.line_types
    for field in fields(lane):
        if field.name in (LANE.names or ()):
            row[field.name] = getattr(lane, field.name)
    if isinstance(lane, CircularLane):
        row["kind"], row["turn"] = CIRCULAR, 1 if lane.clockwise else -1
        row["x"], row["y"] = lane.center
        row["length"] = lane.radius * (lane.end_phase - lane.start_phase) * row["turn"]
    elif isinstance(lane, StraightLane):
        row["kind"] = SINE if isinstance(lane, SineLane) else STRAIGHT
        row["x"], row["y"] = lane.start
        way = np.subtract(lane.end, lane.start, dtype=np.float64)
        row["heading"] = maths.atan2(way[1], way[0])
        row["length"] = np.sqrt(way[0] * way[0] + way[1] * way[1])
        row["direction_x"], row["direction_y"] = way / row["length"]


def _trace(row: Any, lane: PolyLane) -> Curves:
    """The rows of a polyline's curve [`LinearSpline2D.__init__`]; fills the row of its lane."""
    x, y = np.array(lane.points, dtype=np.float64).T
    arc_length = np.hstack((0, np.cumsum(np.sqrt(np.diff(x) ** 2 + np.diff(y) ** 2))))
    metres = np.arange(int(arc_length[-1]) + 1)
    if metres.size < 2:
        raise ValueError(f"a polyline is {arc_length[-1]:g} m long; expected at least 1 m")
    row["kind"], row["length"] = POLYLINE, arc_length[-1]
    widths = lane.widths or (lane.width,)
    row["point_count"], row["pose_count"] = x.size, metres.size
    row["width_count"] = len(widths)
    curve = np.zeros(max(x.size, metres.size, len(widths)), CURVE)
    curve["arc_length"][: x.size], curve["x"][: x.size], curve["y"][: x.size] = arc_length, x, y
    curve["width"][: len(widths)] = widths
    poses = curve[: metres.size]
    poses["pose_x"], poses["pose_y"] = (np.interp(metres, arc_length, each) for each in (x, y))
    ways = [np.diff(poses[name]) for name in ("pose_x", "pose_y")]
    way_x, way_y = (np.append(way, way[-1]) for way in ways)
    length = np.sqrt(way_x**2 + way_y**2)
    poses["normal_x"], poses["normal_y"] = way_x / length, way_y / length
    for pose in poses:
        pose["heading"] = maths.atan2(pose["normal_y"], pose["normal_x"])
    return curve


@register_jitable
def position(road: Network, lane: int, longitudinal: float, lateral: float) -> Pair:
    row = road.lanes[lane]
    if row.kind == POLYLINE:
        return curve_position(row, road.curves, longitudinal, lateral)
    return line_position(row, longitudinal, lateral)


@register_jitable
def heading_at(road: Network, lane: int, longitudinal: float) -> float:
    row = road.lanes[lane]
    if row.kind == POLYLINE:
        return curve_heading(row, road.curves, longitudinal)
    return line_heading(row, longitudinal)


@register_jitable
def width_at(road: Network, lane: int, longitudinal: float) -> float:
    row = road.lanes[lane]
    if row.kind == POLYLINE:
        return curve_width(row, road.curves, longitudinal)
    return float(row.width)


@register_jitable
def local_coordinates(road: Network, lane: int, x: float, y: float) -> Pair:
    row = road.lanes[lane]
    if row.kind == POLYLINE:
        return curve_coordinates(row, road.curves, x, y)
    return line_coordinates(row, x, y)


@register_jitable
def distance_along(
    road: Network, lane: int, x: float, y: float, other_x: float, other_y: float
) -> float:
    other_s, _ = local_coordinates(road, lane, other_x, other_y)
    s, _ = local_coordinates(road, lane, x, y)
    return float(other_s - s)


@register_jitable
def is_on_lane(road: Network, lane: int, x: float, y: float, margin: float) -> bool:
    s, r = local_coordinates(road, lane, x, y)
    is_beside = abs(r) <= width_at(road, lane, s) / 2 + margin
    return is_beside and -END_MARGIN_M <= s < road.lanes[lane].length + END_MARGIN_M


@register_jitable
def is_reachable(road: Network, lane: int, x: float, y: float) -> bool:
    if not 0 <= lane < road.lanes.size or road.lanes[lane].forbidden:
        return False
    s, r = local_coordinates(road, lane, x, y)
    is_close = abs(r) <= 2 * width_at(road, lane, s)
    return is_close and 0 <= s < road.lanes[lane].length + END_MARGIN_M


@register_jitable
def distance(road: Network, lane: int, x: float, y: float) -> float:
    s, r = local_coordinates(road, lane, x, y)
    return _distance(road, lane, s, r)


@register_jitable
def distance_with_heading(road: Network, lane: int, x: float, y: float, heading: float) -> float:
    s, r = local_coordinates(road, lane, x, y)
    return _distance(road, lane, s, r) + abs(wrap_to_pi(heading - heading_at(road, lane, s)))


@register_jitable
def _distance(road: Network, lane: int, s: float, r: float) -> float:
    return float(abs(r) + max(s - road.lanes[lane].length, 0.0) + max(0.0 - s, 0.0))


@register_jitable
def closest_lane(road: Network, x: float, y: float, heading: float) -> int:
    best, shortest = 0, np.inf
    for lane in range(road.lanes.size):
        length = distance_with_heading(road, lane, x, y, heading)
        if length < shortest:
            best, shortest = lane, length
    return best


@register_jitable
def next_lane(road: Network, lane: int, next_road: int, next_id: int, x: float, y: float) -> int:
    s, _ = local_coordinates(road, lane, x, y)
    x, y = position(road, lane, s, 0.0)
    if next_road >= 0:
        return _lane_of_next_road(road, lane, next_road, next_id, x, y)
    best, shortest = lane, np.inf
    first = road.lanes[lane].next_roads
    for following in road.successors[first : first + road.lanes[lane].next_count]:
        candidate = _lane_of_next_road(road, lane, following, -1, x, y)
        length = distance(road, candidate, x, y)
        if length < shortest:
            best, shortest = candidate, length
    return best


@compiled
def _lane_of_next_road(
    road: Network, lane: int, next_road: int, next_id: int, x: float, y: float
) -> int:
    """[`RoadNetwork.next_lane_given_next_road`]"""
    row, following = road.lanes[lane], road.lanes[next_road]
    if row.lanes == following.lanes:
        return next_road + (lane - row.first if next_id < 0 else next_id)
    best, shortest = next_road, np.inf
    for candidate in range(next_road, next_road + following.lanes):
        length = distance(road, candidate, x, y)
        if length < shortest:
            best, shortest = candidate, length
    return best


@register_jitable
def leads_to(road: Network, lane: int, following: int) -> bool:
    """Whether the road with the first lane `following` starts where a lane ends."""
    row = road.lanes[lane]
    for k in range(row.next_roads, row.next_roads + row.next_count):
        if road.successors[k] == following:
            return True
    return False


@register_jitable
def side_lanes(road: Network, lane: int) -> tuple[int, int]:
    return road.lanes[lane].left, road.lanes[lane].right
