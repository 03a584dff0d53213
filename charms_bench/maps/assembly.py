"""Makes a road map of what an importer has found: nodes, bridged gaps, conflicts."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from charms_bench.errors import MapError
from charms_bench.foundation.arrays import Floats
from charms_bench.maps.conflicts import conflicts_of
from charms_bench.maps.elements import LARGEST
from charms_bench.maps.road_map import (
    SHORTEST_POLYLINE_M,
    Gap,
    MapLane,
    MapRoad,
    RoadMap,
    Signal,
)
from charms_bench.maps.sampling import lengths_of, stations
from charms_bench.maps.shapes import points_of
from charms_bench.world.road_network import CircularLane, StraightLane

TOUCH_M = 0.5
"""Linked lanes whose ends are closer than this are left as they are in the map, and so are lanes of
different widths whose borders are: a lane that ends where its width is 0 ends beside the next."""
TINY_M = 0.01
"""Shorter roads are left out; links lead over them."""
WIDEST_GAP_M = 100.0
"""Wider gaps are a fault of the map."""
WIDEST_LANE_M, LONGEST_LANE_M, LONGEST_MAP_M = 100.0, 1e6, 1e8
"""A map with wider or longer lanes, or more of them, is wrong; it would also take long to read."""
STEEPEST, STEP_M = 2.0, 1.0
"""A lane that rises by more than this part of a distance and this step is a fault of the map."""
FAR_M = 10_000.0
"""If a coordinate is larger, the origin is moved."""
DECIMALS = 6
"""Of positions, m, so that a road file says the same as the map that it was made of."""
MOST_PARTS = 64
"""Into which a road is cut; a lane that then turns back has a kink."""
_LOOKED_AT = 400
"""The most points at which a lane is looked at."""
_BACK_M = 0.1
_SAME_M = 1e-4
"""Points that are closer than this are one."""


@dataclass
class Draft:
    """What an importer has found, in the map's own coordinates, y to the left of x."""

    format: str
    left_hand_traffic: bool = False
    roads: list[MapRoad] = field(default_factory=list)
    """Without nodes."""
    where: dict[str, str] = field(default_factory=dict)
    """The element that each lane is, for errors."""
    links: dict[tuple[str, str], str] = field(default_factory=dict)
    """Each lane with a lane that follows, and the junction in which that is if it is known."""
    open_links: set[tuple[str, str]] = field(default_factory=set)
    """Those over junctions whose lanes the map leaves out, so that gaps are bridged."""
    gives_way: set[tuple[str, str]] = field(default_factory=set)
    """The pairs of lanes of which the first gives way to the second; `A->B` bridges a gap."""
    signals: list[Signal] = field(default_factory=list)
    left_out: dict[str, int] = field(default_factory=dict)

    def leave_out(self, reason: str, count: int = 1) -> None:
        """Counts lanes that are left out."""
        self.left_out[reason] = self.left_out.get(reason, 0) + count

    def add(self, lanes: Iterable[tuple[MapLane, str]], junction: str, roundabout: bool) -> None:
        """Adds a road of lanes from the left to the right, each with the element that it is."""
        several = list(lanes)
        for lane, where in several:
            if lane.id in self.where:
                raise MapError(f"{where}: there is another lane {lane.id!r}; ids must differ")
            self.where[lane.id] = where
        self.roads.append(MapRoad("", "", tuple(lane for lane, _ in several), junction, roundabout))


def without_repeated(points: Floats) -> Floats:
    """The points (N, 4) of a line without those that are where the one before is."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    kept = np.append(True, steps > _SAME_M)
    kept[-1] = True
    found: Floats = points[kept]
    if len(found) > 2 and np.hypot(*(found[-1] - found[-2])[:2]) <= _SAME_M:
        found = np.delete(found, -2, axis=0)
    return found


def assembled(draft: Draft, name: str) -> RoadMap:
    """The road map.

    Raises:
        MapError: No lane is left, or linked lanes do not touch.
    """
    if not draft.roads:
        reasons = "; ".join(f"{count} {reason}" for reason, count in draft.left_out.items())
        raise MapError(f"has no lane on which cars drive ({reasons or 'it has no lanes'})")
    kept = _without_tiny(draft)
    _check(draft, kept)
    origin = _origin(kept)
    roads = [_moved(road, origin) for road in kept]
    signals = [
        replace(each, x=_rounded(each.x - origin[0]), y=_rounded(origin[1] - each.y))
        for each in draft.signals
    ]
    links, bridges, gaps = _bridged(draft, roads)
    junctions = {*draft.links.values(), *(road.junction for road in roads)} - {""}
    roads, links, parts_of = _with_nodes([*roads, *bridges], links)
    gives_way = {
        (one, other)
        for first, second in draft.gives_way
        for one in parts_of.get(first, (first,))
        for other in parts_of.get(second, (second,))
    }
    signals = [
        replace(each, lanes=tuple(parts_of.get(lane, (lane,))[-1] for lane in each.lanes))
        for each in signals
    ]
    gaps = [
        Gap(
            (parts_of.get(one, (one,))[-1], parts_of.get(other, (other,))[0]),
            length,
            parts_of.get(bridge, (bridge,)),
        )
        for ((one, other), length, (bridge,)) in ((g.lanes, g.length, g.bridge) for g in gaps)
    ]
    after: dict[str, list[str]] = {}
    for one, other in links:
        after.setdefault(one, []).append(other)
    roads = [
        replace(
            road,
            lanes=tuple(
                replace(lane, successors=tuple(after.get(lane.id, ()))) for lane in road.lanes
            ),
        )
        for road in roads
    ]
    return RoadMap(
        name=name,
        format=draft.format,
        roads=tuple(roads),
        origin=origin,
        left_hand_traffic=draft.left_hand_traffic,
        junctions=tuple(sorted(junctions)),
        conflicts=tuple(conflicts_of(roads, gives_way)),
        signals=tuple(signals),
        gaps=tuple(gaps),
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


def _check(draft: Draft, roads: list[MapRoad]) -> None:
    """Raises a `MapError` for lanes that no map has, from wrong numbers."""
    total = 0.0
    for lane in (lane for road in roads for lane in road.lanes):
        points, where = lane.points, draft.where[lane.id]
        if not (np.isfinite(points).all() and np.abs(points).max() <= LARGEST):
            raise MapError(f"{where}: has a point beyond {LARGEST:g} m")
        along = lengths_of(points)
        total += along[-1]
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
        exact = _exact(lane, points, origin)
        if isinstance(exact, CircularLane):
            points = points_of(exact, (points[0, 2], points[-1, 2]))
        lanes.append(replace(lane, points=points, exact=exact))
    return replace(road, lanes=tuple(lanes))


def _exact(
    lane: MapLane, points: Floats, origin: tuple[float, float]
) -> StraightLane | CircularLane | None:
    """The moved shape of a lane: an arc that it is, or a straight line between two points."""
    width = float(points[0, 3])
    if isinstance(lane.exact, CircularLane):
        x, y = lane.exact.center
        return replace(
            lane.exact,
            center=(x - origin[0], origin[1] - y),
            start_phase=-lane.exact.start_phase,
            end_phase=-lane.exact.end_phase,
            clockwise=not lane.exact.clockwise,
        )
    if len(points) == 2 and points[1, 3] == width:
        start, end = points[:, :2].tolist()
        return StraightLane(start=(start[0], start[1]), end=(end[0], end[1]), width=width)
    return None


Links = dict[tuple[str, str], None]


def _bridged(draft: Draft, roads: list[MapRoad]) -> tuple[Links, list[MapRoad], list[Gap]]:
    """The links with bridges in those of lanes that do not touch, the bridges, and the gaps."""
    lane_of = {lane.id: lane for road in roads for lane in road.lanes}
    links: Links = {}
    bridges, gaps = [], []
    for (one, other), junction in draft.links.items():
        end, start = lane_of[one].points[-1], lane_of[other].points[0]
        gap = float(np.hypot(*(start - end)[:2]))
        if gap <= TOUCH_M + abs(end[3] - start[3]) / 2:
            links[one, other] = None
            continue
        most = WIDEST_GAP_M if (one, other) in draft.open_links else TOUCH_M
        if gap > most:
            raise MapError(
                f"{draft.where[one]}: ends {gap:.2f} m from where the following lane "
                f"{other!r} starts; expected at most {most:g} m"
            )
        bridge = _bridge(lane_of[one], lane_of[other], gap)
        bridges.append(MapRoad("", "", (bridge,), junction or f"gap after {one}"))
        gaps.append(Gap((one, other), round(gap, 3), (bridge.id,)))
        links |= {(one, bridge.id): None, (bridge.id, other): None}
    return links, bridges, gaps


def _bridge(one: MapLane, other: MapLane, gap: float) -> MapLane:
    """A cubic Hermite curve between two ends, with tangents as long as the gap."""
    start, end = one.points[-1], other.points[0]
    leaving, arriving = one.points[-1] - one.points[-2], other.points[1] - other.points[0]
    tangents = [gap * each[:2] / np.hypot(*each[:2]) for each in (leaving, arriving)]

    def curve(part: Floats) -> Floats:
        t = (part / gap)[:, None]
        height = t * t * (3 - 2 * t)
        found = start + (end - start) * t
        found[:, :2] = start[:2] * (1 - height) + end[:2] * height
        found[:, :2] += (t * (1 - t) ** 2) * tangents[0] + (t * t * (t - 1)) * tangents[1]
        return np.asarray(found[:, None, :])

    s = stations(curve, np.array([0.0, gap]))
    points = np.round(curve(s)[:, 0], DECIMALS) + 0.0
    points[[0, -1]] = start, end
    limits = [each.speed_limit for each in (one, other) if each.speed_limit is not None]
    lane = MapLane(f"{one.id}->{other.id}", points, None, min(limits, default=None), one.type)
    return replace(lane, exact=_exact(lane, points, (0.0, 0.0)))


def _with_nodes(
    roads: list[MapRoad], links: Links
) -> tuple[list[MapRoad], Links, Mapping[str, tuple[str, ...]]]:
    """The roads with the names of their nodes, the links, and the parts of lanes that were cut.

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
        lanes = _cut(road.lanes, 1 if (start, end) not in taken else 2)
        taken.add((start, end))
        nodes = [start, *(f"{start}-{end}-{k}-{part}" for part in range(1, len(lanes))), end]
        for ends, part in zip(pairwise(nodes), lanes, strict=True):
            found.append(replace(road, start=ends[0], end=ends[1], lanes=part))
        if len(lanes) > 1:
            for lane, parts in zip(road.lanes, zip(*lanes, strict=True), strict=True):
                parts_of[lane.id] = tuple(part.id for part in parts)
    moved: Links = {}
    for one, other in links:
        moved[parts_of.get(one, (one,))[-1], parts_of.get(other, (other,))[0]] = None
    for parts in parts_of.values():
        moved |= dict.fromkeys(pairwise(parts))
    return found, moved, parts_of


def _cut(lanes: tuple[MapLane, ...], count: int) -> list[tuple[MapLane, ...]]:
    """The lanes in so many parts of equal length, or in more where one of them turns back."""
    while True:
        parts = [lanes] if count == 1 else [*zip(*(_parts(each, count) for each in lanes))]  # noqa: B905
        if count >= MOST_PARTS or not any(_turns_back(lane) for part in parts for lane in part):
            return parts
        count *= 2


def _turns_back(lane: MapLane) -> bool:
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
        inside = lane.points[(along > low + _SAME_M) & (along < high - _SAME_M)]
        ends = [[np.interp(s, along, column) for column in lane.points.T] for s in (low, high)]
        points = np.round(np.vstack([ends[:1], inside, ends[1:]]), DECIMALS) + 0.0
        exact: StraightLane | CircularLane | None = None
        if isinstance(lane.exact, CircularLane):
            first, last = lane.exact.start_phase, lane.exact.end_phase
            phases = [first + (last - first) * part / count for part in (k, k + 1)]
            exact = replace(lane.exact, start_phase=phases[0], end_phase=phases[1])
            points = points_of(exact, (float(points[0, 2]), float(points[-1, 2])))
        elif isinstance(lane.exact, StraightLane):
            exact = _exact(lane, points, (0.0, 0.0))
        found.append(replace(lane, id=f"{lane.id}/{k + 1}", points=points, exact=exact))
    return found
