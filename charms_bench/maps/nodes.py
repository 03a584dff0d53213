"""Gives roads the nodes at their ends, and cuts roads where highway-env's rules need it."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from charms_bench.maps.draft import SAME_M
from charms_bench.maps.road_map import DECIMALS, SHORTEST_POLYLINE_M, MapLane, MapRoad
from charms_bench.maps.sampling import lengths_of
from charms_bench.maps.shapes import points_of, straight
from charms_bench.world.road_network import CircularLane, StraightLane

MOST_PARTS = 64
"""Into which a road is cut; a lane that then turns back has a kink."""
_LOOKED_AT = 400
"""The most points at which a lane is looked at."""
_BACK_M = 0.1


def with_nodes(
    roads: Sequence[MapRoad], links: Iterable[tuple[str, str]]
) -> tuple[list[MapRoad], dict[str, tuple[str, ...]]]:
    """The roads with the names of their nodes and lanes with successors, and parts of cut lanes.

    A road is cut into roads after each other where highway-env's rules need that: two roads between
    the same nodes would be one road of neighbours, and a position along a polyline is not found if
    that turns back.
    """
    number = {lane.id: k for k, road in enumerate(roads) for lane in road.lanes}
    # Port 2 k is the start of road k, and port 2 k + 1 its end.
    root = list(range(2 * len(roads)))

    def find(port: int) -> int:
        while root[port] != port:
            root[port] = root[root[port]]
            port = root[port]
        return port

    for one, other in links:
        root[find(2 * number[one] + 1)] = find(2 * number[other])
    names: dict[int, str] = {}
    found: list[MapRoad] = []
    taken: set[tuple[str, str]] = set()
    parts_of: dict[str, tuple[str, ...]] = {}
    for k, road in enumerate(roads):
        start, end = (names.setdefault(find(2 * k + e), str(len(names))) for e in (0, 1))
        cut = _cut(road.lanes, 1 if (start, end) not in taken else 2)
        taken.add((start, end))
        nodes = [start, *(f"{start}-{end}-{k}-{part}" for part in range(1, len(cut))), end]
        for ends, part in zip(pairwise(nodes), cut, strict=True):
            found.append(replace(road, start=ends[0], end=ends[1], lanes=part))
        if len(cut) > 1:
            for lane, parts in zip(road.lanes, zip(*cut, strict=True), strict=True):
                parts_of[lane.id] = tuple(part.id for part in parts)
    after: dict[str, tuple[str, ...]] = dict(
        pair for parts in parts_of.values() for pair in ((a, (b,)) for a, b in pairwise(parts))
    )
    for one, other in links:
        last, first = parts_of.get(one, (one,))[-1], parts_of.get(other, (other,))[0]
        after[last] = (*after.get(last, ()), first)
    for k, road in enumerate(found):
        lanes = (replace(lane, successors=after.get(lane.id, ())) for lane in road.lanes)
        found[k] = replace(road, lanes=tuple(lanes))
    return found, parts_of


def _cut(lanes: tuple[MapLane, ...], count: int) -> list[tuple[MapLane, ...]]:
    """The lanes in so many parts of equal length, or in more where one of them turns back."""
    while True:
        parts = [lanes] if count == 1 else [*zip(*(_parts(each, count) for each in lanes))]  # noqa: B905
        if count >= MOST_PARTS or not any(turns_back(lane) for part in parts for lane in part):
            return parts
        count *= 2


def turns_back(lane: MapLane) -> bool:
    """Whether a point of a lane is not behind all later points, as seen along the lane there.

    highway-env looks for a position from the end of a polyline on [`LinearSpline2D`].
    """
    along = lengths_of(lane.points)
    if lane.exact is not None or along[-1] < SHORTEST_POLYLINE_M:
        return False
    s = np.linspace(0.0, along[-1], int(np.clip(along[-1] + 1, 2, _LOOKED_AT)))
    places = np.stack([np.interp(s, along, column) for column in lane.points.T[:2]], axis=1)
    way = np.diff(places, axis=0)
    ahead = (way * places[:-1]).sum(axis=1)[:, None] - way @ places[:-1].T
    # An earlier point may be ahead by rounding, and where a map has a kink.
    return bool((np.tril(ahead, -1) < -_BACK_M * np.hypot(*way.T)[:, None]).any())


def _parts(lane: MapLane, count: int) -> list[MapLane]:
    """The parts of a lane, all as long."""
    along = lengths_of(lane.points)
    cuts = np.linspace(0.0, along[-1], count + 1)
    found = []
    for k, (low, high) in enumerate(pairwise(cuts)):
        inside = lane.points[(along > low + SAME_M) & (along < high - SAME_M)]
        ends = [[np.interp(s, along, column) for column in lane.points.T] for s in (low, high)]
        points = np.round(np.vstack([ends[:1], inside, ends[1:]]), DECIMALS) + 0.0
        exact: StraightLane | CircularLane | None = None
        if isinstance(lane.exact, CircularLane):
            first, last = lane.exact.start_phase, lane.exact.end_phase
            phases = [first + (last - first) * part / count for part in (k, k + 1)]
            exact = replace(lane.exact, start_phase=phases[0], end_phase=phases[1])
            points = points_of(exact, (float(points[0, 2]), float(points[-1, 2])))
        elif isinstance(lane.exact, StraightLane):
            exact = straight(points)
        found.append(replace(lane, id=f"{lane.id}/{k + 1}", points=points, exact=exact))
    return found
