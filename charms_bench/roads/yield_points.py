"""Where lanes of a road in a file meet, so that vehicles give way there.

They meet where they cross or merge, from where their centres come closer than `CLOSE_M` on. In a
junction, they also meet where they pass each other too closely: closer than `BESIDE_M`, and in
curves, of which vehicles sweep more than their width, `SWEPT_M2` times the curvatures more, unless
both lead in the same direction.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.maps.conflicts import LEVEL_M
from charms_bench.maps.road_map import MapLane, RoadMap
from charms_bench.maps.sampling import lengths_of

CLOSE_M, ROOM_M = 3.2, 1.5
"""How close the centres of lanes are where they meet, and how far a centre stays from there."""
BESIDE_M, SWEPT_M2 = 2.5, 4.0
"""The room that two vehicles 2 m wide need beside each other, and the factor for curves."""
SAME_COS = 0.5
"""Lanes at a smaller angle lead in the same direction."""
BEND_M = 4.0
"""The length of the part of a lane whose curvature is computed."""
REACH_M, STEP_M = 40.0, 0.5
"""So far around a place, and in such steps, lanes are compared."""
GIVES_WAY, UNKNOWN, GOES_FIRST = -1, 0, 1


class Meetings(NamedTuple):
    """The C places where a lane meets another one, lane after lane; each place is there twice."""

    ends: Ints
    """(L,) the number of places up to each lane."""
    other: Ints
    """(C,) the other lane."""
    begins: Floats
    """(C,) from where on a vehicle's centre on the lane is at the place, m along it."""
    until: Floats
    """(C,) and up to where."""
    other_begins: Floats
    """(C,) the same along the other lane."""
    other_until: Floats
    order: Ints
    """(C,) `GIVES_WAY`, `UNKNOWN` or `GOES_FIRST`."""


def meetings_of(road: RoadMap, indices: dict[str, int]) -> Meetings:
    """Where the lanes of a map meet, by the indices of the lanes."""
    lanes = {lane.id: lane for lane in road.lanes}
    lines = _with_parts_before(road)
    found: list[list[tuple[float, ...]]] = [[] for _ in indices]
    known = [(each.lanes, each.at, each.kind, each.gives_way, CLOSE_M) for each in road.conflicts]
    for names, at, kind, gives_way, close_m in (*known, *_passing(road)):
        both = [(lines[name], lanes[name].length) for name in names]
        is_end = kind == "merging"
        parts = [_part(*both[k], both[1 - k][0], at[k], is_end, close_m) for k in (0, 1)]
        for k in (0, 1):
            own, across = names[k], names[1 - k]
            order = UNKNOWN
            if gives_way:
                order = GIVES_WAY if gives_way == own else GOES_FIRST
            found[indices[own]].append((indices[across], *parts[k], *parts[1 - k], order))
    flat = np.array([each for lane in found for each in lane], dtype=np.float64).reshape(-1, 6)
    columns = [np.ascontiguousarray(column) for column in flat.T]
    ends = np.cumsum([len(lane) for lane in found])
    begins, until, other_begins, other_until = columns[1:5]
    return Meetings(
        ends,
        columns[0].astype(np.int64),
        begins,
        until,
        other_begins,
        other_until,
        columns[5].astype(np.int64),
    )


Passing = tuple[tuple[str, str], tuple[float, float], str, str, float]


def _passing(road: RoadMap) -> Iterator[Passing]:
    """The lanes of junctions that neither cross nor merge, but pass each other too closely.

    If a lane meets the lane behind the other one, the part before belongs to that place.
    With how far along them that is, "passing", nothing about who gives way, and how close it is.
    """
    known = {frozenset(each.lanes) for each in road.conflicts}
    starts: dict[str, set[str]] = {}
    for lane in road.lanes:
        for after in lane.successors:
            starts.setdefault(after, set()).add(lane.id)
    within: dict[str, list[tuple[int, MapLane]]] = {}
    for number, each in enumerate(road.roads):
        if each.junction:
            within.setdefault(each.junction, []).extend((number, lane) for lane in each.lanes)
    for members in within.values():
        shapes = [_shape(lane) for _, lane in members]
        for i, j in combinations(range(len(members)), 2):
            (road_i, one), (road_j, other) = members[i], members[j]
            names = one.id, other.id
            follow = one.id in other.successors or other.id in one.successors
            part = bool(starts.get(one.id, set()) & starts.get(other.id, set()))
            pairs = [names, *((after, other.id) for after in one.successors)]
            pairs += [(one.id, after) for after in other.successors]
            is_known = any(frozenset(pair) in known for pair in pairs)
            if road_i == road_j or follow or part or is_known:
                continue
            at = _too_close(shapes[i], shapes[j])
            if at is not None:
                yield names, at[:2], "passing", "", max(at[2], CLOSE_M)


class _Shape(NamedTuple):
    """A lane every `STEP_M`."""

    along: Floats
    points: Floats
    """(N, 3)"""
    directions: Floats
    """(N, 2)"""
    curvatures: Floats


def _shape(lane: MapLane) -> _Shape:
    along = lengths_of(lane.points)
    s = np.linspace(0.0, along[-1], max(round(along[-1] / STEP_M), 1) + 1)
    points = np.stack([np.interp(s, along, column) for column in lane.points[:, :3].T], axis=1)
    ways = np.gradient(points[:, :2], axis=0)
    directions = ways / np.maximum(np.hypot(*ways.T), 1e-9)[:, None]
    headings = np.unwrap(np.arctan2(directions[:, 1], directions[:, 0]))
    reach = BEND_M / 2
    before, after = np.maximum(s - reach, 0.0), np.minimum(s + reach, s[-1])
    turned = np.interp(after, s, headings) - np.interp(before, s, headings)
    return _Shape(s, points, directions, np.abs(turned) / np.maximum(after - before, STEP_M))


def _too_close(one: _Shape, other: _Shape) -> tuple[float, float, float] | None:
    """Where two lanes pass each other most closely, and how close they may be; None if they are
    not closer anywhere."""
    apart = one.points[:, None] - other.points
    cosine = one.directions @ other.directions.T
    swept = SWEPT_M2 * (one.curvatures[:, None] + other.curvatures)
    least = BESIDE_M + np.where(cosine < SAME_COS, swept, 0.0)
    room = np.hypot(apart[..., 0], apart[..., 1]) - least
    room[np.abs(apart[..., 2]) > LEVEL_M] = np.inf
    i, j = np.unravel_index(int(room.argmin()), room.shape)
    if room[i, j] >= 0.0:
        return None
    return float(one.along[i]), float(other.along[j]), float(least[i, j])


def _with_parts_before(road: RoadMap) -> dict[str, Floats]:
    """The points (N, 2) of each lane, behind those of the lane that alone leads there in the same
    junction: a vehicle that waits there can be in the way, too."""
    junctions = {lane.id: each.junction for each in road.roads for lane in each.lanes}
    before: dict[str, list[MapLane]] = {}
    for lane in road.lanes:
        for after in lane.successors:
            before.setdefault(after, []).append(lane)
    found = {}
    for lane in road.lanes:
        found[lane.id] = lane.points[:, :2]
        several = before.get(lane.id, [])
        if len(several) == 1 and junctions[lane.id] == junctions[several[0].id] != "":
            found[lane.id] = np.vstack([several[0].points[:-1, :2], lane.points[:, :2]])
    return found


def _part(
    line: Floats, length: float, other: Floats, at: float, is_end: bool, close_m: float
) -> tuple[float, float]:
    """Where a lane is close to another one around a place, with room for half a vehicle, m.

    The lane is the end of its line (N, 2); a place before it is negative.
    """
    along = lengths_of(line)
    along -= along[-1] - length
    s = np.arange(max(at - REACH_M, along[0]), min(at + REACH_M, length) + STEP_M, STEP_M)
    s = np.minimum(s, along[-1])
    x, y = (np.interp(s, along, column) for column in line.T)
    theirs = lengths_of(other)
    there = np.arange(0.0, theirs[-1] + STEP_M, STEP_M)
    other_x, other_y = (np.interp(there, theirs, column) for column in other.T)
    away = np.hypot(x[:, None] - other_x, y[:, None] - other_y).min(axis=1)
    first = last = int(np.abs(s - at).argmin())
    while first > 0 and away[first - 1] < close_m:
        first -= 1
    while last < s.size - 1 and away[last + 1] < close_m:
        last += 1
    return float(s[first] - ROOM_M), float(along[-1] if is_end else s[last] + ROOM_M)
