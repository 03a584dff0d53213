"""Where the lanes of a network cross and merge, computed once, from the lanes' geometry."""

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.maps.conflicts import conflicts_of
from charms_bench.maps.road_map import MapLane, MapRoad
from charms_bench.roads.fault import NO_RANK
from charms_bench.world.interaction_observation import RANGE_M
from charms_bench.world.road import heading_at, next_lane, position
from charms_bench.world.road_network import Network, roads_after

MERGING, CROSSING = range(2)
BEHIND, NOT_SAID, FIRST = -1, 0, 1
"""Whether vehicles of a lane give way, nothing says so, or vehicles of the other lane do."""
PIECE_M = 1.0
"""The longest piece of the polylines in place of lanes: 1 cm from an arc with a radius of 13 m."""
ENDS_ASIDE_M = 1.0
"""A lane ends if the lane after it starts so far beside it; its vehicles have to merge."""


class Conflicts(NamedTuple):
    """The conflicts of each lane, lane after lane, and those lanes that lead to each of them."""

    first: Ints
    """[L + 1] the first conflict of each lane."""
    s: Floats
    """[C] how far along the lane the conflict point is, m."""
    other: Ints
    """[C] the other lane."""
    other_s: Floats
    """[C] how far along the other lane it is, m."""
    kind: Ints
    """[C] `MERGING` or `CROSSING`."""
    into: Ints
    """[C] the lane into which both merge; -1 for a crossing."""
    priority: Ints
    """[C] `FIRST` if vehicles of the lane have the right of way, `BEHIND` if those of the other
    lane have it, and else `NOT_SAID`."""
    first_feed: Ints
    """[C + 1] the first of the lanes that lead to each conflict."""
    feed: Ints
    """[F] the other lane and those from which vehicles come to it within `RANGE_M`."""
    to_go: Floats
    """[F] how far it is from their starts to the conflict point, m."""
    leftmost: Ints
    """[S] for each road that follows another one (`Network.successors`), the number of the leftmost
    lane that ends where it starts, or closest to it."""
    rightmost: Ints
    """[S] that of the rightmost one."""


def conflicts(road: Network, ranks: Ints) -> Conflicts:
    """The conflicts of a network's lanes.

    Where ranks say nothing, the vehicle of a lane that ends gives way to those beside it. Where
    they are equal, the one that has the other on its right gives way at a crossing (Vienna
    Convention on Road Traffic, Article 18). `ranks` (L,) are those of `fault.Fault`.
    """
    count = road.lanes.size
    after = [_after(road, lane) for lane in range(count)]
    before: dict[int, list[int]] = defaultdict(list)
    for lane, following in enumerate(after):
        for each in dict.fromkeys(following):
            before[each].append(lane)
    found: list[list[tuple[float, int, float, int, int, int]]] = [[] for _ in range(count)]
    for conflict in conflicts_of(_roads(road, after), frozenset()):
        lanes, at = (int(conflict.lanes[0]), int(conflict.lanes[1])), conflict.at
        shared = sorted({*after[lanes[0]]} & {*after[lanes[1]]})
        is_merging = conflict.kind == "merging"
        for into in shared if is_merging else (-1,):
            first = _priority(road, ranks, lanes, at, into)
            kind = MERGING if is_merging else CROSSING
            for k, sign in enumerate((1, -1)):
                place = at[k], lanes[1 - k], at[1 - k]
                found[lanes[k]].append((*place, kind, into, sign * first))
    rows = [row for lane in found for row in sorted(set(lane))]
    feeds = [list(_feeds(road, before, row[1], row[2])) for row in rows]
    table = np.array(rows, dtype=np.float64).reshape(-1, 6).T
    integers = table.astype(np.int64)
    flat = [feed for each in feeds for feed in each]
    return Conflicts(
        first=np.cumsum([0, *(len(set(lane)) for lane in found)]),
        s=table[0],
        other=integers[1],
        other_s=table[2],
        kind=integers[3],
        into=integers[4],
        priority=integers[5],
        first_feed=np.cumsum([0, *map(len, feeds)]),
        feed=np.array([lane for lane, _ in flat], dtype=np.int64),
        to_go=np.array([to_go for _, to_go in flat], dtype=np.float64),
        **_leading(road),
    )


def _leading(road: Network) -> dict[str, Ints]:
    """`Conflicts.leftmost` and `rightmost`."""
    leftmost = np.zeros(road.successors.size, dtype=np.int64)
    rightmost = leftmost.copy()
    for first in np.unique(road.lanes["first"]).tolist():
        lanes = range(first, first + int(road.lanes["lanes"][first]))
        start = int(road.lanes["next_roads"][first])
        for k, following in enumerate(roads_after(road, first), start):
            into = range(following, following + int(road.lanes["lanes"][following]))
            aside = [min(_aside(road, lane, each) for each in into) for lane in lanes]
            leads = np.nonzero(np.array(aside) <= min(aside) + ENDS_ASIDE_M)[0]
            leftmost[k], rightmost[k] = leads[0], leads[-1]
    return {"leftmost": leftmost, "rightmost": rightmost}


def _after(road: Network, lane: int) -> list[int]:
    """The lanes that follow a lane, at most one on each road that starts at its end.

    Those that start beside its end follow it only if it ends there.
    """
    length = float(road.lanes["length"][lane])
    x, y = position(road, lane, length, 0.0)
    heading = heading_at(road, lane, length)
    found = [int(next_lane(road, lane, each, -1, x, y)) for each in roads_after(road, lane)]
    ahead = [each for each in found if math.cos(heading_at(road, each, 0.0) - heading) > 0]
    direct = [each for each in ahead if _aside(road, lane, each) <= ENDS_ASIDE_M]
    return direct or ahead


def _roads(road: Network, after: list[list[int]]) -> list[MapRoad]:
    """The network as a map of polylines."""
    roads = []
    for first in np.unique(road.lanes["first"]).tolist():
        lanes = []
        for lane in range(first, first + int(road.lanes["lanes"][first])):
            length = float(road.lanes["length"][lane])
            along = np.linspace(0.0, length, max(math.ceil(length / PIECE_M), 1) + 1)
            places = [(*position(road, lane, float(s), 0.0), 0.0, 0.0) for s in along]
            successors = tuple(map(str, dict.fromkeys(after[lane])))
            lanes.append(MapLane(str(lane), np.array(places), successors=successors))
        roads.append(MapRoad("", "", tuple(lanes)))
    return roads


def _priority(
    road: Network, ranks: Ints, lanes: tuple[int, int], at: tuple[float, float], into: int
) -> int:
    """Whether the first of two lanes has the right of way; see `Conflicts.priority`."""
    rank, other = int(ranks[lanes[0]]), int(ranks[lanes[1]])
    has_ranks = NO_RANK not in (rank, other)
    if has_ranks and rank != other:
        return FIRST if rank > other else BEHIND
    if into >= 0:
        aside = [_aside(road, lane, into) > ENDS_ASIDE_M for lane in lanes]
        return NOT_SAID if aside[0] == aside[1] else BEHIND if aside[0] else FIRST
    if not has_ranks:
        return NOT_SAID
    apart = heading_at(road, lanes[1], at[1]) - heading_at(road, lanes[0], at[0])
    # The y-axis points to the right of the x-axis, so the other one comes from the right.
    return BEHIND if math.sin(apart) < 0 else FIRST


def _aside(road: Network, lane: int, into: int) -> float:
    """How far the end of a lane is from the start of another one, m."""
    x, y = position(road, lane, float(road.lanes["length"][lane]), 0.0)
    other_x, other_y = position(road, into, 0.0, 0.0)
    return math.hypot(other_x - x, other_y - y)


def _feeds(
    road: Network, before: dict[int, list[int]], lane: int, to_go: float
) -> Iterator[tuple[int, float]]:
    """A lane and those that lead to it, with the distances to a point of it; the nearest first."""
    seen, waiting = {lane}, [(to_go, lane)]
    while waiting:
        waiting.sort()
        distance, nearest = waiting.pop(0)
        yield nearest, distance
        for each in before[nearest]:
            if distance < RANGE_M and each not in seen:
                seen.add(each)
                waiting.append((distance + float(road.lanes["length"][each]), each))
