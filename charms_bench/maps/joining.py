"""Joins short roads that only follow each other, so that vehicles see far enough along a lane."""

from collections import defaultdict
from dataclasses import replace

import numpy as np

from charms_bench.maps.draft import SAME_M
from charms_bench.maps.nodes import turns_back
from charms_bench.maps.road_map import MapLane, MapRoad, RoadMap
from charms_bench.maps.shapes import straight

SHORT_M = 30.0
"""Of two roads, one is at most as long; together, they are at most `LONGEST_M`."""
TINY_M = 5.0
"""A lane up to this length can have another speed limit; the longer one's holds."""
LONGEST_M = 300.0


def joined(road: RoadMap) -> RoadMap:
    """The same map in which roads are joined that follow each other and nothing else.

    They have the same number of lanes, each of which leads to one lane with the same speed limit,
    and they are in the same junction or in none. A joined lane has the name of the first. Roads
    stay apart where a signal is between them, or highway-env's rules need it; see `nodes`.
    """
    roads, moved = _joined_roads(road)
    places = {lane.id: (lane.id, 0.0) for each in roads for lane in each.lanes}
    for lane, (after, along) in reversed(moved.items()):
        first, offset = places[after]
        places[lane] = first, offset + along

    def named(lanes: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(places[lane][0] for lane in lanes)

    conflicts = [
        replace(
            each,
            lanes=(places[each.lanes[0]][0], places[each.lanes[1]][0]),
            at=(
                places[each.lanes[0]][1] + each.at[0],
                places[each.lanes[1]][1] + each.at[1],
            ),
            gives_way=places[each.gives_way][0] if each.gives_way else "",
        )
        for each in road.conflicts
    ]
    return replace(
        road,
        roads=tuple(roads),
        conflicts=tuple(each for each in conflicts if each.lanes[0] != each.lanes[1]),
        signals=tuple(replace(each, lanes=named(each.lanes)) for each in road.signals),
        gaps=tuple(
            replace(
                each,
                lanes=(places[each.lanes[0]][0], places[each.lanes[1]][0]),
                bridge=named(each.bridge),
            )
            for each in road.gaps
        ),
    )


def _joined_roads(road: RoadMap) -> tuple[list[MapRoad], dict[str, tuple[str, float]]]:
    """The roads, and for each lane that is part of another one, that one and how far along."""
    starting: dict[str, list[MapRoad]] = defaultdict(list)
    ending: dict[str, list[MapRoad]] = defaultdict(list)
    for each in road.roads:
        starting[each.start].append(each)
        ending[each.end].append(each)
    taken = {(each.start, each.end) for each in road.roads}
    lit = {lane for each in road.signals for lane in each.lanes}
    gone: dict[str, tuple[str, float]] = {}
    kept = {id(each): each for each in road.roads}
    for node in [*starting]:
        if len(starting[node]) != 1 or len(ending[node]) != 1:
            continue
        one, other = ending[node][0], starting[node][0]
        if one is other or (one.start, other.end) in taken or not _fit(one, other):
            continue
        if any(lane.id in lit for lane in one.lanes):
            continue
        lanes = tuple(map(_joined_lane, one.lanes, other.lanes))
        if any(map(turns_back, lanes)):
            continue
        whole = replace(one, end=other.end, lanes=lanes)
        taken -= {(one.start, one.end), (other.start, other.end)}
        taken.add((whole.start, whole.end))
        for first, second in zip(one.lanes, other.lanes, strict=True):
            gone[second.id] = first.id, first.length
            lit |= {first.id} if second.id in lit else set()
        kept.pop(id(other))
        kept[id(one)] = whole
        kept = {id(each): each for each in kept.values()}
        for lists, end in ((starting, whole.start), (ending, whole.end)):
            lists[end] = [whole if each in (one, other) else each for each in lists[end]]
    return [*kept.values()], gone


def _fit(one: MapRoad, other: MapRoad) -> bool:
    """Whether two roads that follow each other can be one."""
    if len(one.lanes) != len(other.lanes):
        return False
    if (one.junction, one.roundabout) != (other.junction, other.roundabout):
        return False
    lengths = max(each.length for each in one.lanes), max(each.length for each in other.lanes)
    return (
        min(lengths) <= SHORT_M
        and sum(lengths) <= LONGEST_M
        and all(
            first.successors == (second.id,)
            and (first.speed_limit == second.speed_limit or min(lengths) <= TINY_M)
            for first, second in zip(one.lanes, other.lanes, strict=True)
        )
    )


def _joined_lane(one: MapLane, other: MapLane) -> MapLane:
    same = np.hypot(*(one.points[-1] - other.points[0])[:2]) <= SAME_M
    points = np.vstack([one.points, other.points[1:] if same else other.points])
    limit = max(one, other, key=lambda lane: lane.length).speed_limit
    return replace(
        one,
        points=points,
        exact=straight(points),
        speed_limit=limit,
        successors=other.successors,
    )
