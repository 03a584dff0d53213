"""What an importer has found in a map, from which a road map is made."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from charms_bench.errors import MapError
from charms_bench.foundation.arrays import Floats
from charms_bench.maps.road_map import MapLane, MapRoad, Signal

SAME_M = 1e-4
"""Points that are closer than this are one."""
Links = dict[tuple[str, str], str]
"""Each lane with a lane that follows, and the junction in which that is, empty if in none."""


@dataclass
class Draft:
    """What an importer has found, in the map's own coordinates, y to the left of x."""

    format: str
    left_hand_traffic: bool = False
    roads: list[MapRoad] = field(default_factory=list)
    """Without nodes."""
    where: dict[str, str] = field(default_factory=dict)
    """The element that each lane is, for errors."""
    links: Links = field(default_factory=dict)
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
    kept = np.append(True, steps > SAME_M)
    kept[-1] = True
    found: Floats = points[kept]
    if len(found) > 2 and np.hypot(*(found[-1] - found[-2])[:2]) <= SAME_M:
        found = np.delete(found, -2, axis=0)
    return found
