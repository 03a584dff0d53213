"""A road map: roads of parallel lanes between nodes, and where lanes cross and merge.

Positions are in the coordinates of the project: x as in the map and y in the opposite direction, so
that a positive lateral offset is to the right, both from the map's `origin` on. Units are SI.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from charms_bench.foundation.arrays import Floats
from charms_bench.maps.sampling import lengths_of
from charms_bench.world.lane_geometry import Pair
from charms_bench.world.road_network import (
    NO_LINE,
    SOLID_LINE,
    STRIPED,
    CircularLane,
    Lane,
    PolyLane,
    SineLane,
    StraightLane,
)

DECIMALS = 6
"""Of positions, m, so that a road file says the same as the map that it was made of."""
SHORTEST_POLYLINE_M = 1.0
"""Below this length, a lane of an environment is straight: highway-env has no shorter polylines."""
UNSTATED_SPEED_MPS = 20.0
"""The speed limit of lanes whose map states none [`AbstractLane`]."""
Exact = StraightLane | SineLane | CircularLane
Program = tuple[tuple[float, str], ...]
"""How long a light is `green` or `red`, s, again and again from the start on."""


@dataclass(frozen=True, eq=False)
class MapLane:
    """A lane on which cars drive, from where they enter it to where they leave it."""

    id: str
    points: Floats
    """(N, 4) x, y, height and width at points of its centre line, m."""
    exact: Exact | None = None
    """Its shape, if that is a straight line, a sine or an arc; otherwise it is the polyline."""
    speed_limit: float | None = None
    """m/s; None if the map states none."""
    type: str = "driving"
    """What the map calls it."""
    successors: tuple[str, ...] = ()
    """The ids of the lanes that follow."""

    @property
    def length(self) -> float:
        """Along the centre line in the plane, m."""
        if isinstance(self.exact, CircularLane):
            return self.exact.radius * abs(self.exact.end_phase - self.exact.start_phase)
        return float(lengths_of(self.points)[-1])

    def lane(self, line_types: tuple[int, int]) -> Lane:
        """The lane as `charms_bench.world.road_network` describes it."""
        limit = UNSTATED_SPEED_MPS if self.speed_limit is None else self.speed_limit
        x, y, _, width = self.points.T
        if self.exact is not None:
            values = vars(self.exact) | {"speed_limit": limit, "line_types": line_types}
            return type(self.exact)(**values)
        along = lengths_of(self.points)
        if along[-1] < SHORTEST_POLYLINE_M + 1e-6:
            ends: tuple[Pair, Pair] = ((x[0], y[0]), (x[-1], y[-1]))
            return StraightLane(
                start=ends[0],
                end=ends[1],
                width=float(width.mean()),
                speed_limit=limit,
                line_types=line_types,
            )
        widths = np.interp(np.arange(int(along[-1]) + 1), along, width)
        return PolyLane(
            points=tuple(zip(x.tolist(), y.tolist(), strict=True)),
            widths=() if (width == width[0]).all() else tuple(widths.tolist()),
            width=float(width[0]),
            speed_limit=limit,
            line_types=line_types,
        )


def _turns_back(points: Floats) -> bool:
    """Whether a line goes back from one of its points, by more than a right angle."""
    steps = np.diff(points[:, :2], axis=0)
    return bool(((steps[1:] * steps[:-1]).sum(axis=1) < 0).any())


@dataclass(frozen=True)
class MapRoad:
    """Parallel lanes in one direction between two nodes, from the left to the right."""

    start: str
    end: str
    lanes: tuple[MapLane, ...]
    junction: str = ""
    """The junction that it is in; empty outside of junctions."""
    roundabout: bool = False


@dataclass(frozen=True)
class Conflict:
    """Where two lanes cross or merge at one level."""

    lanes: tuple[str, str]
    at: tuple[float, float]
    """How far along each lane, m."""
    kind: str
    """`crossing` or `merging`."""
    gives_way: str = ""
    """The lane whose vehicles give way; empty if the map does not say."""


@dataclass(frozen=True)
class Signal:
    """A traffic light or a sign."""

    id: str
    kind: str
    """`light` or `sign`."""
    x: float
    y: float
    code: str = ""
    """What the map calls it, such as the number of a sign."""
    lanes: tuple[str, ...] = ()
    """The lanes for which it is: vehicles stop at their ends, or before those in a junction."""
    program: Program = ()


@dataclass(frozen=True)
class Gap:
    """Where linked lanes do not touch in the map, and the lane that leads over the gap."""

    lanes: tuple[str, str]
    length: float
    """From the end of the one to the start of the other, m."""
    bridge: tuple[str, ...]
    """The ids of that lane's parts, a cubic Hermite curve along the headings of the two ends."""


@dataclass(frozen=True, eq=False)
class RoadMap:
    """A road map as it was read; see the module."""

    name: str
    format: str
    """The format of the file that it comes from, with its version."""
    roads: tuple[MapRoad, ...]
    origin: Pair = (0.0, 0.0)
    """The map's coordinates of the point (0, 0)."""
    left_hand_traffic: bool = False
    junctions: tuple[str, ...] = ()
    """The junctions in which lanes follow each other."""
    conflicts: tuple[Conflict, ...] = ()
    signals: tuple[Signal, ...] = ()
    gaps: tuple[Gap, ...] = ()
    left_out: Mapping[str, int] = field(default_factory=dict)
    """How many lanes, and programs of lights, were left out, by the reason."""

    @property
    def lanes(self) -> Iterator[MapLane]:
        """All lanes, road after road."""
        return chain.from_iterable(road.lanes for road in self.roads)

    def edges(self) -> Iterator[tuple[str, str, Lane]]:
        """The lanes with the nodes at their ends, for `charms_bench.roads.layout.Layout`."""
        for road in self.roads:
            last = len(road.lanes) - 1
            for k, lane in enumerate(road.lanes):
                lines = (
                    (NO_LINE, NO_LINE) if road.junction else
                    (STRIPED if k else SOLID_LINE, SOLID_LINE if k == last else NO_LINE)
                )  # fmt: skip
                yield road.start, road.end, lane.lane(lines)

    def _followers_without_a_link(self) -> int:
        """How many roads follow a road at a node, though none of its lanes leads to them."""
        road_of = {lane.id: k for k, road in enumerate(self.roads) for lane in road.lanes}
        starting = Counter(road.start for road in self.roads)
        linked = {(road_of[lane.id], road_of[s]) for lane in self.lanes for s in lane.successors}
        return sum(starting[road.end] for road in self.roads) - len(linked)

    def facts(self) -> dict[str, Any]:
        """What the map has, as numbers and texts."""
        lanes = list(self.lanes)
        limits = sorted({each.speed_limit for each in lanes if each.speed_limit is not None})
        followed = {successor for lane in lanes for successor in lane.successors}
        points = np.concatenate([lane.points for lane in lanes])
        x, y = points[:, 0] + self.origin[0], self.origin[1] - points[:, 1]
        kinds = [each.kind for each in self.conflicts]
        return {
            "name": self.name,
            "format": self.format,
            "lane_km": sum(lane.length for lane in lanes) / 1000,
            "lanes": len(lanes),
            "roads": len(self.roads),
            "nodes": len({node for road in self.roads for node in (road.start, road.end)}),
            "junctions": len(self.junctions),
            "followers_without_a_link": self._followers_without_a_link(),
            "roundabout_roads": sum(road.roundabout for road in self.roads),
            "starts": sum(lane.id not in followed for lane in lanes),
            "ends": sum(not lane.successors for lane in lanes),
            "left_hand_traffic": self.left_hand_traffic,
            "speed_limits_mps": limits,
            "lanes_without_speed_limit": sum(lane.speed_limit is None for lane in lanes),
            "width_m": [float(points[:, 3].min()), float(points[:, 3].max())],
            "x_m": [float(x.min()), float(x.max())],
            "y_m": [float(y.min()), float(y.max())],
            "origin_m": list(self.origin),
            "crossing_conflicts": kinds.count("crossing"),
            "merging_conflicts": kinds.count("merging"),
            "conflicts_with_right_of_way": sum(bool(each.gives_way) for each in self.conflicts),
            "lights": sum(each.kind == "light" for each in self.signals),
            "signs": sum(each.kind == "sign" for each in self.signals),
            "lanes_that_turn_back": [lane.id for lane in lanes if _turns_back(lane.points)],
            "gaps": [{"lanes": list(gap.lanes), "length_m": gap.length} for gap in self.gaps],
            "left_out": dict(self.left_out),
        }
