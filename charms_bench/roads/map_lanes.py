"""The lanes of a road map as vehicles drive on them: limits in curves, right of way, and levels."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Floats
from charms_bench.maps.conflicts import LEVEL_M, conflicts_of
from charms_bench.maps.joining import joined
from charms_bench.maps.reading import read_road
from charms_bench.maps.road_map import MapLane, RoadMap
from charms_bench.maps.sampling import lengths_of
from charms_bench.roads.layout import Edge, Layout
from charms_bench.world.named_road import hash_of
from charms_bench.world.road_network import CircularLane, StraightLane

LATERAL_MPS2, SLOWEST_MPS = 3.0, 3.0
"""In curves, limits are such that the lateral acceleration is at most the first."""
CURVE_M = 4.0
"""The radius of a curve is that of so long a part of a lane."""
MOST_LANES = 10_000
APPROACH_M = 50.0
FLAT = (1.0, 1.0, 0.0, 1.0)
"""x, y and width of a point, without its height."""
RANKS = 10
"""The most levels of priority."""


@lru_cache(maxsize=2)
def map_of(path: Path, sha256: str) -> RoadMap:
    """The road map in a file with this content.

    Raises:
        InputError: It has changed, or is too large.
        MapError: It cannot be read.
    """
    now = hash_of(path)
    if now != sha256:
        raise InputError(
            f"{path}: the road has changed since the settings were made; expected a file with the "
            f"hash {sha256[:12]}, found {now[:12]}"
        )
    found = joined(read_road(path))
    count = sum(len(road.lanes) for road in found.roads)
    if count > MOST_LANES:
        raise InputError(
            f"{path}: {count:,} lanes; expected at most {MOST_LANES:,}; cut the map with "
            "charms-bench road --around X Y --radius R --to"
        )
    return found


def indices_of(road: RoadMap, layout: Layout) -> dict[str, int]:
    """The indices of a map's lanes in their layout, by their names in the map."""
    return {
        lane.id: layout.lanes[each.start, each.end, k]
        for each in road.roads
        for k, lane in enumerate(each.lanes)
    }


def driven_lanes(road: RoadMap) -> Iterator[Edge]:
    """The lanes of a map with their nodes, limits in curves and priorities."""
    priorities = priorities_of(road)
    lanes = [lane for each in road.roads for lane in each.lanes]
    for lane, (start, end, found) in zip(lanes, road.edges(), strict=True):
        limit = min(found.speed_limit, limit_in_curves(lane))
        yield start, end, replace(found, speed_limit=limit, priority=priorities.get(lane.id, 0))


def limit_in_curves(lane: MapLane) -> float:
    """The speed at which the tightest curve of a lane takes `LATERAL_MPS2`, m/s."""
    if type(lane.exact) is StraightLane:
        return math.inf
    exact = lane.exact
    radius = exact.radius if isinstance(exact, CircularLane) else _tightest(lane.points)
    return max(math.sqrt(LATERAL_MPS2 * radius), SLOWEST_MPS)


def _tightest(points: Floats) -> float:
    """The smallest radius of a polyline, m."""
    ways = np.diff(points[:, :2], axis=0)
    lengths = np.hypot(ways[:, 0], ways[:, 1])
    along = np.cumsum(lengths) - lengths / 2
    heading = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    if along.size < 2:
        return math.inf
    at = np.arange(along[0], along[-1] + 1.0)
    turned = np.abs(np.interp(at + CURVE_M, along, heading) - np.interp(at, along, heading))
    return float(CURVE_M / max(turned.max(), 1e-9))


def priorities_of(road: RoadMap) -> dict[str, int]:
    """The priority of each lane that has one: it is above those of the lanes that give way to it.

    The lanes that lead there, up to `APPROACH_M` before, have the highest of theirs, as at
    highway-env's intersection. Where lanes give way to each other in a circle, `RANKS` levels are
    the end.
    """
    before: dict[str, list[str]] = {}
    for lane in road.lanes:
        for after in lane.successors:
            before.setdefault(after, []).append(lane.id)
    pairs = [
        (each.gives_way, each.lanes[each.lanes[0] == each.gives_way])
        for each in road.conflicts
        if each.gives_way
    ]
    found = {lane: 0 for pair in pairs for lane in pair}
    for _ in range(RANKS):
        for lower, higher in pairs:
            found[higher] = min(max(found[higher], found[lower] + 1), RANKS)
    given = {*found}
    edge = [(name, 0.0) for name in found]
    lengths = {lane.id: lane.length for lane in road.lanes}
    for name, along in edge:
        for earlier in before.get(name, ()) if along < APPROACH_M else ():
            if earlier not in given and found.get(earlier, -1) < found[name]:
                found[earlier] = found[name]
                edge.append((earlier, along + lengths[earlier]))
    return found


def levels_of(road: RoadMap) -> dict[str, int]:
    """The level of each lane that crosses another one above or below it, from 1 on.

    Lanes of different levels have nothing to do with each other.
    """
    heights = [lane.points[:, 2] for lane in road.lanes]
    if max(each.max() for each in heights) - min(each.min() for each in heights) < LEVEL_M:
        return {}
    flat = [
        replace(each, lanes=tuple(replace(lane, points=lane.points * FLAT) for lane in each.lanes))
        for each in road.roads
    ]
    at_one_level = {frozenset(each.lanes) for each in road.conflicts}
    lanes = {lane.id: lane for lane in road.lanes}
    found: dict[str, int] = {}
    pairs = []
    for each in conflicts_of(flat, set()):
        if each.kind == "crossing" and frozenset(each.lanes) not in at_one_level:
            height = [
                float(np.interp(at, lengths_of(lanes[name].points), lanes[name].points[:, 2]))
                for name, at in zip(each.lanes, each.at, strict=True)
            ]
            pairs.append(each.lanes if height[0] < height[1] else each.lanes[::-1])
            found |= dict.fromkeys(each.lanes, 1)
    for _ in range(RANKS):
        for low, high in pairs:
            found[high] = max(found[high], found[low] + 1)
    return found
