"""A network of lanes from above, and where vehicles are on it, for pictures."""

from dataclasses import dataclass, replace

import numpy as np

from charms_bench.world.road import position, width_at
from charms_bench.world.road_network import Network
from charms_bench.world.scene import Bools, Floats

STEP_M = 2.0
"""About how far apart the points of a line are."""
NO_LINE, STRIPED = 0, 1
"""Kinds of lines between lanes; the others are continuous [`LineType`]."""
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
        s = np.linspace(0.0, row["length"], max(2, round(row["length"] / STEP_M) + 1))

        def beside(side: float, lane: int = lane, s: Floats = s) -> Floats:
            """The points at a number of half widths and shoulders beside the lane."""
            half = [float(width_at(road, lane, each)) / 2 for each in s]
            more = SHOULDER_M * (abs(side) > 1) * np.sign(side)
            points = [
                position(road, lane, float(each), np.sign(side) * wide + more)
                for each, wide in zip(s, half, strict=True)
            ]
            return np.array(points)

        surfaces.append(np.concatenate((beside(-2.0), beside(2.0)[::-1])))
        for side, kind in ((-1.0, row["line_left"]), (1.0, row["line_right"])):
            if kind != NO_LINE:
                (striped if kind == STRIPED else continuous).append(beside(side))
    return Lines(tuple(surfaces), tuple(continuous), tuple(striped))


@dataclass(frozen=True, eq=False)
class Plan:
    """N vehicles on a network, [..., N]; x and y are those of the network."""

    lines: Lines
    present: Bools
    is_obstacle: Bools
    x: Floats
    y: Floats
    heading: Floats

    def at(self, frame: int) -> "Plan":
        """The plan at one moment of several."""
        names = ("present", "is_obstacle", "x", "y", "heading")
        return replace(self, **{name: getattr(self, name)[frame] for name in names})
