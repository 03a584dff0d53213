"""Where lanes cross or merge."""

from collections.abc import Sequence, Set
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from charms_bench.errors import MapError
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.maps.road_map import Conflict, MapLane, MapRoad
from charms_bench.maps.sampling import lengths_of

LEVEL_M = 3.0
"""Lanes that are further apart in height do not conflict: no vehicle fits between lower levels."""
END_M = 1.0
"""Lanes that touch within this distance of both of their ends follow, leave or join each other."""
_STEEP = 0.17
"""Lanes whose angle has a smaller sine cross only if they change sides, by `_ASIDE_M` within
`_NEAR_M`: polylines of lanes that lie on each other cross without a meaning."""
_ASIDE_M = 0.03
_NEAR_M = 10.0
SAME_M = 1.0
"""Crossings of two lanes that are closer along both are one."""
MOST_PAIRS = 200_000_000
"""Of pieces that are close to each other; a large map has some ten million."""
_PIECE_M = 4.0


def conflicts_of(roads: Sequence[MapRoad], gives_way: Set[tuple[str, str]]) -> list[Conflict]:
    """The conflicts, merging ones first, in the order of the lanes.

    Args:
        roads: Lanes of one road do not cross.
        gives_way: The pairs of lanes of which the first gives way to the second.
    """
    lanes = [lane for road in roads for lane in road.lanes]
    lengths = np.array([lane.length for lane in lanes])
    before: dict[str, list[int]] = {}
    for k, lane in enumerate(lanes):
        for successor in lane.successors:
            before.setdefault(successor, []).append(k)
    merging = [
        (i, j, float(lengths[i]), float(lengths[j]), "merging")
        for joined in before.values()
        for i, j in combinations(joined, 2)
    ]
    of_road = np.repeat(np.arange(len(roads)), [len(road.lanes) for road in roads])
    found: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for i, j, s, r, sine in _crossings(lanes, of_road):
        at_end = [[s < END_M, s > lengths[i] - END_M], [r < END_M, r > lengths[j] - END_M]]
        if any(at_end[0]) and any(at_end[1]):
            continue
        if abs(sine) < _STEEP and not _changes_sides(lanes[i].points, s, lanes[j].points, r):
            continue
        places = found.setdefault((i, j), [])
        if all(abs(s - one) > SAME_M or abs(r - other) > SAME_M for one, other in places):
            places.append((s, r))
    crossing = [(*pair, *place, "crossing") for pair in sorted(found) for place in found[pair]]
    return [
        _conflict(lanes[i].id, lanes[j].id, (s, r), kind, gives_way)
        for i, j, s, r, kind in dict.fromkeys([*merging, *crossing])
    ]


def _changes_sides(one: Floats, s: float, other: Floats, r: float) -> bool:
    """Whether a polyline goes from one side of another to the other side, near a crossing."""
    along = lengths_of(one), lengths_of(other)

    def place(k: int, distance: float) -> Floats:
        points = (one, other)[k]
        return np.array([np.interp(distance, along[k], points[:, axis]) for axis in range(2)])

    # Half of the way to an end: where lanes part or join, they are on no side.
    room = [
        [min(_NEAR_M, distance / 2) for distance in (at, length - at)]
        for at, length in ((s, along[0][-1]), (r, along[1][-1]))
    ]
    way = place(1, r + room[1][1]) - place(1, r - room[1][0])
    turn = 1 if way @ (place(0, s + room[0][1]) - place(0, s - room[0][0])) >= 0 else -1
    aside = []
    for sign in (-1, 1):
        near = min(room[0][sign > 0], room[1][sign * turn > 0])
        aside.append(place(0, s + sign * near) - place(1, r + sign * turn * near))
    before, after = (float(way[0] * each[1] - way[1] * each[0]) for each in aside)
    least = _ASIDE_M * float(np.hypot(*way))
    return before * after < 0 and min(abs(before), abs(after)) > least


def _conflict(
    one: str, other: str, at: tuple[float, float], kind: str, gives_way: Set[tuple[str, str]]
) -> Conflict:
    waits = [pair[0] for pair in ((one, other), (other, one)) if pair in gives_way]
    rounded = round(at[0], 3), round(at[1], 3)
    return Conflict((one, other), rounded, kind, waits[0] if len(waits) == 1 else "")


def _crossings(
    lanes: Sequence[MapLane], of_road: Ints
) -> list[tuple[int, int, float, float, float]]:
    """The lanes of each crossing at one level, how far along them it is, and the angle's sine."""
    pieces = [_pieces(lane.points) for lane in lanes]
    lane_of = np.repeat(np.arange(len(lanes)), [len(each) for each in pieces])
    table = np.concatenate(pieces)
    start, end = table[:, :3], table[:, 3:6]
    middle = (start[:, :2] + end[:, :2]) / 2
    tree = cKDTree(middle)
    if (count := int(tree.count_neighbors(tree, _PIECE_M))) > MOST_PAIRS:
        raise MapError(f"{count:,} pieces of lanes lie on each other; is a part of it repeated?")
    pairs = tree.query_pairs(_PIECE_M, output_type="ndarray")
    one, other = np.sort(pairs, axis=1).T
    apart = of_road[lane_of[one]] != of_road[lane_of[other]]
    one, other = one[apart], other[apart]
    p, q = start[one], start[other]
    d, e = end[one] - p, end[other] - q
    cross = d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]
    w = q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (w[:, 0] * e[:, 1] - w[:, 1] * e[:, 0]) / cross
        u = (w[:, 0] * d[:, 1] - w[:, 1] * d[:, 0]) / cross
        height = np.abs(p[:, 2] + t * d[:, 2] - q[:, 2] - u * e[:, 2])
        there = (t >= 0) & (t <= 1) & (u >= 0) & (u <= 1) & (height <= LEVEL_M)
    size = [np.hypot(each[:, 0], each[:, 1]) for each in (d, e)]
    found = []
    for k in np.nonzero(there)[0].tolist():
        i, j = lane_of[one[k]], lane_of[other[k]]
        s = table[one[k], 6] + t[k] * size[0][k]
        r = table[other[k], 6] + u[k] * size[1][k]
        sine = cross[k] / (size[0][k] * size[1][k])
        found.append((int(i), int(j), float(s), float(r), float(sine)))
    return sorted(found)


def _pieces(points: Floats) -> Floats:
    """The lane in pieces (N, 7) of at most `_PIECE_M`: their starts, ends, and how far they are."""
    along = lengths_of(points)
    steps = np.diff(along)
    counts = np.maximum(np.ceil(steps / _PIECE_M).astype(np.int64), 1)
    # Where each piece starts, as the number of a step and a part of it.
    step = np.repeat(np.arange(steps.size), counts)
    part = (np.arange(step.size) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[step]
    s = np.append(along[step] + part * steps[step], along[-1])
    corners = np.stack([np.interp(s, along, points[:, k]) for k in range(3)], axis=1)
    return np.column_stack([corners[:-1], corners[1:], s[:-1]])
