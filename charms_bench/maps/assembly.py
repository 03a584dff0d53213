"""Makes a road map of what an importer has found."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from charms_bench.errors import MapError
from charms_bench.maps.bridging import bridged
from charms_bench.maps.conflicts import conflicts_of
from charms_bench.maps.draft import Draft
from charms_bench.maps.elements import LARGEST
from charms_bench.maps.nodes import with_nodes
from charms_bench.maps.road_map import DECIMALS, Exact, MapRoad, RoadMap
from charms_bench.maps.sampling import lengths_of
from charms_bench.maps.shapes import points_of, straight
from charms_bench.world.road_network import CircularLane

TINY_M = 0.01
"""Shorter roads are left out; links lead over them."""
SHORTEST_M = 1e-3
"""Of a lane beside longer ones."""
WIDEST_LANE_M, LONGEST_LANE_M, LONGEST_MAP_M = 100.0, 1e6, 1e8
"""A map with wider or longer lanes, or more of them, is wrong; it would also take long to read."""
STEEPEST, STEP_M = 2.0, 1.0
"""A lane that rises by more than this part of a distance and this step is a fault of the map."""
FAR_M = 10_000.0
"""If a coordinate is larger, the origin is moved."""


def assembled(draft: Draft, name: str) -> RoadMap:
    """The road map.

    Raises:
        MapError: No lane is left, or linked lanes do not touch.
    """
    kept = _without_tiny(draft)
    if not kept:
        reasons = "; ".join(f"{count} {reason}" for reason, count in draft.left_out.items())
        raise MapError(f"has no lane on which cars drive ({reasons or 'it has no lanes'})")
    check_lanes(kept, draft.where)
    origin = _origin(kept)
    roads = [_moved(road, origin) for road in kept]
    links, bridges, gaps = bridged(draft, roads)
    roads, parts_of = with_nodes([*roads, *bridges], links)

    def parts(lane: str) -> tuple[str, ...]:
        return parts_of.get(lane, (lane,))

    gives_way = {
        (one, other)
        for first, second in draft.gives_way
        for one in parts(first)
        for other in parts(second)
    }
    known = {lane.id for road in roads for lane in road.lanes}
    inside = {lane.id for road in roads if road.junction for lane in road.lanes}

    def lit(lane: str) -> str:
        several = parts(lane)
        return several[0 if several[0] in inside else -1]

    junctions = {*links.values(), *(road.junction for road in roads)} - {""}
    return RoadMap(
        name=name,
        format=draft.format,
        roads=tuple(roads),
        origin=origin,
        left_hand_traffic=draft.left_hand_traffic,
        junctions=tuple(sorted(junctions)),
        conflicts=tuple(conflicts_of(roads, gives_way)),
        signals=tuple(
            # A light stands at the end of a lane, or before a junction.
            replace(
                each,
                x=_rounded(each.x - origin[0]),
                y=_rounded(origin[1] - each.y),
                lanes=tuple(lit(lane) for lane in each.lanes if lit(lane) in known),
            )
            for each in draft.signals
        ),
        gaps=tuple(
            replace(
                each,
                lanes=(parts(each.lanes[0])[-1], parts(each.lanes[1])[0]),
                bridge=parts(each.bridge[0]),
            )
            for each in gaps
        ),
        left_out=dict(sorted(draft.left_out.items())),
    )


def _without_tiny(draft: Draft) -> list[MapRoad]:
    """The roads without those that are shorter than `TINY_M`, over which links lead directly."""
    tiny = [road for road in draft.roads if all(lane.length < TINY_M for lane in road.lanes)]
    gone = {lane.id: None for road in tiny for lane in road.lanes}
    if not gone:
        return draft.roads
    after: dict[str, dict[str, str]] = {lane: {} for lane in gone}
    before: dict[str, dict[str, str]] = {lane: {} for lane in gone}
    for (one, other), junction in draft.links.items():
        if one in gone:
            after[one][other] = junction
        if other in gone:
            before[other][one] = junction
    for lane in gone:
        for one in before[lane]:
            draft.links.pop((one, lane))
            for other, junction in after[lane].items():
                if lane in (one, other):
                    continue
                draft.links[one, other] = junction
                if one in gone:
                    after[one][other] = junction
                    after[one].pop(lane, None)
                if other in gone:
                    before[other][one] = junction
        for other in after[lane]:
            draft.links.pop((lane, other), None)
            if other in gone:
                before[other].pop(lane, None)
    draft.leave_out(f"shorter than {TINY_M * 100:g} cm, passed over by links", len(gone))
    return [road for road in draft.roads if road.lanes[0].id not in gone]


def check_lanes(roads: Iterable[MapRoad], named: Mapping[str, str]) -> None:
    """Raises a `MapError` for lanes that no map has, from wrong numbers.

    `named` is what messages call a lane, by its id.
    """
    total = 0.0
    for lane in (lane for road in roads for lane in road.lanes):
        points, where = lane.points, named[lane.id]
        if not (np.isfinite(points).all() and np.abs(points).max() <= LARGEST):
            raise MapError(f"{where}: has a point beyond {LARGEST:g} m")
        along = lengths_of(points)
        total += along[-1]
        if along[-1] < SHORTEST_M:
            raise MapError(
                f"{where}: is {along[-1]:g} m long, but other lanes of its road are longer"
            )
        if points[:, 3].min() < 0 or points[:, 3].max() > WIDEST_LANE_M:
            low, high = points[:, 3].min(), points[:, 3].max()
            raise MapError(
                f"{where}: is {low:g} to {high:g} m wide; expected 0 to {WIDEST_LANE_M:g} m"
            )
        if along[-1] > LONGEST_LANE_M or total > LONGEST_MAP_M:
            raise MapError(
                f"{where}: is {along[-1]:g} m long, the lanes up to it {total:g} m; expected at "
                f"most {LONGEST_LANE_M:g} and {LONGEST_MAP_M:g} m"
            )
        rises = np.abs(np.diff(points[:, 2])) - STEEPEST * np.diff(along)
        if rises.max(initial=0.0) > STEP_M:
            step = int(rises.argmax())
            raise MapError(
                f"{where}: its height goes from {points[step, 2]:g} to {points[step + 1, 2]:g} m "
                f"within {along[step + 1] - along[step]:.2f} m; correct the elevation"
            )


def _origin(roads: list[MapRoad]) -> tuple[float, float]:
    """A point of whole metres in the middle of the map if it is far from (0, 0)."""
    points = [lane.points[:, :2] for road in roads for lane in road.lanes]
    low = np.min([each.min(axis=0) for each in points], axis=0)
    high = np.max([each.max(axis=0) for each in points], axis=0)
    if max(np.abs(low).max(), np.abs(high).max()) <= FAR_M:
        return 0.0, 0.0
    x, y = np.round((low + high) / 2).tolist()
    return x, y


def _rounded(value: float) -> float:
    return round(value, DECIMALS) + 0.0


def _moved(road: MapRoad, origin: tuple[float, float]) -> MapRoad:
    lanes = []
    for lane in road.lanes:
        points = lane.points * (1, -1, 1, 1) + (-origin[0], origin[1], 0, 0)
        points = np.round(points, DECIMALS) + 0.0
        exact: Exact | None = straight(points)
        if isinstance(lane.exact, CircularLane):
            exact = _mirrored(lane.exact, origin)
            points = points_of(exact, (points[0, 2], points[-1, 2]))
        lanes.append(replace(lane, points=points, exact=exact))
    return replace(road, lanes=tuple(lanes))


def _mirrored(arc: CircularLane, origin: tuple[float, float]) -> CircularLane:
    """An arc of the map in the coordinates of the project."""
    x, y = arc.center
    return replace(
        arc,
        center=(x - origin[0], origin[1] - y),
        start_phase=-arc.start_phase,
        end_phase=-arc.end_phase,
        clockwise=not arc.clockwise,
    )
