"""A network of lanes from above, and where vehicles are on it, for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from charms_bench.world.lane_geometry import STRAIGHT
from charms_bench.world.road import position, width_at
from charms_bench.world.road_network import NO_LINE, STRIPED, Network
from charms_bench.world.scene import Bools, Floats
from charms_bench.world.tracks import Bodies

STEP_M = 2.0
"""About how far apart the points of a line are."""
SHOULDER_M = 1.0


@dataclass(frozen=True, eq=False)
class Lines:
    """What is drawn of the lanes; each array (K, 2) has points along it, m."""

    surfaces: tuple[Floats, ...]
    """Outlines of the lanes with their shoulders."""
    continuous: tuple[Floats, ...]
    striped: tuple[Floats, ...]


def lines_of(road: Network) -> Lines:
    """The lines of a network."""
    surfaces: list[Floats] = []
    continuous: list[Floats] = []
    striped: list[Floats] = []
    for lane, row in enumerate(road.lanes):
        steps = max(1, round(row["length"] / STEP_M))
        ends, points = (np.linspace(0.0, row["length"], 1 + k) for k in (1, steps))
        s = ends if row["kind"] == STRAIGHT else points

        def beside(side: float, s: Floats, lane: int = lane) -> Floats:
            """Points beside the lane, on its left or right edge or, beyond 1, on its shoulder."""
            half = [float(width_at(road, lane, each)) / 2 for each in s]
            more = SHOULDER_M * (abs(side) > 1) * np.sign(side)
            found = [
                position(road, lane, float(each), np.sign(side) * wide + more)
                for each, wide in zip(s, half, strict=True)
            ]
            return np.array(found)

        surfaces.append(np.concatenate((beside(-2.0, s), beside(2.0, s)[::-1])))
        for side, kind in ((-1.0, row["line_left"]), (1.0, row["line_right"])):
            if kind == STRIPED:
                striped.append(beside(side, points))
            elif kind != NO_LINE:
                continuous.append(beside(side, s))
    return Lines(tuple(surfaces), tuple(continuous), tuple(striped))


OF_VEHICLES = tuple(each.name for each in fields(Bodies))
"""What a plan has of each vehicle."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan(Bodies):
    """N vehicles on a network: x and y are the network's, and lanes are indices of its lanes."""

    road: Network
    lines: Lines
    is_obstacle: Bools

    def at(self, frame: int) -> "Plan":
        """The plan at one moment of several."""
        names = ("is_obstacle", *OF_VEHICLES)
        return replace(self, **{name: getattr(self, name)[frame] for name in names})


def plan_over_time(plans: Sequence[Plan]) -> Plan:
    """The plan of all moments, from the plan of each."""
    names = ("is_obstacle", *OF_VEHICLES)
    stacked = {name: np.stack([getattr(plan, name) for plan in plans]) for name in names}
    return Plan(road=plans[0].road, lines=plans[0].lines, **stacked)
