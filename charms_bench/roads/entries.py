"""How a vehicle enters a road on which others have the right of way.

In a merge, it is the vehicle that leaves the ramp, and in a roundabout, it is the ego. It enters in
the simulation step in which a main lane is first its nearest lane. Its leader and its follower are
the nearest vehicles on that lane then, at most `RANGE_M` ahead and behind along the main lanes.

The post-encroachment time (PET; Allen, Shin & Cooper 1978) is the time until the front of the
follower reaches the place that the rear of the entering vehicle had then, interpolated linearly in
a simulation step. There is none if one of the two crashes first, if the follower leaves the lane,
or after `PET_LIMIT_S`.
"""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.scenes import OBSTACLE, Scenes
from charms_bench.world.road import local_coordinates
from charms_bench.world.road_network import Network, roads_after

RANGE_M = 100.0
IMPOSED_S = 2.0
"""For this long after the entry, the follower's braking is attributed to it."""
PET_LIMIT_S = 5.0
"""A longer PET is not recorded."""
MEASURES = ("entry_lead_gap_m", "entry_lag_gap_m", "entry_braking_mps2", "entry_pet_s")
CHAINED = np.dtype([("lane", np.int64), ("offset", np.float64)])
"""A lane of a chain, and where it starts along the lane in question, m."""
ENTRY = np.dtype(
    [
        *((name, np.float64) for name in (*MEASURES, "since_s", "place", "last")),
        *((name, np.int64) for name in ("vehicle", "lane", "follower")),
        ("meets", np.bool_),
    ]
)
"""The entry of a scene; a measure that does not exist is not a number.

since_s: The time since the entry.
place: Where the follower's centre is along the entered lane when it reaches the place, m.
last: Where it was after the last simulation step, m.
vehicle: The entering vehicle; -1 for none.
lane: The lane that it has entered; -1 before that.
follower: Its follower then; -1 for none.
meets: Whether the follower may still reach the place.
"""


class Entries:
    """The entries of B scenes; `main` (L,) says on which lanes others have the right of way."""

    def __init__(self, count: int, scenes: Scenes, main: Bools) -> None:
        self.table = np.zeros(count, ENTRY)
        self._main = main
        chains = [list(_chain(scenes.road, lane, main)) for lane in range(main.size)]
        self._chains = np.array([each for chain in chains for each in chain], CHAINED)
        self._ends = np.cumsum([len(chain) for chain in chains])

    def start(self, rows: Ints, vehicles: Ints) -> None:
        """Starts the scenes `rows` (R,), in which these vehicles (R,) will enter; -1 for none."""
        table = self.table
        for name in MEASURES:
            table[name][rows] = np.nan
        table["vehicle"][rows], table["lane"][rows], table["follower"][rows] = vehicles, -1, -1
        table["meets"][rows] = False

    def note(self, scenes: Scenes, rows: Ints) -> None:
        """Notes what a simulation step has led to in the scenes `rows`."""
        note(scenes, rows, self._main, self._chains, self._ends, self.table)

    @property
    def measures(self) -> dict[str, Floats]:
        """The measures (B,) by name."""
        return {name: self.table[name] for name in MEASURES}


def _chain(road: Network, lane: int, main: Bools) -> Iterable[tuple[int, float]]:
    """The main lanes with its number before and after a lane, and where they start along it, m.

    The lane itself comes first, then those before it. Lanes further than `RANGE_M` are left out.
    """
    lengths = road.lanes["length"]
    yield lane, 0.0
    before, start = lane, 0.0
    while start > -RANGE_M and (before := _beside(road, before, main, -1)) >= 0:
        start -= lengths[before]
        yield before, start
    after, end = lane, lengths[lane]
    while end < RANGE_M and (after := _beside(road, after, main, 1)) >= 0:
        yield after, end
        end += lengths[after]


def _beside(road: Network, lane: int, main: Bools, side: int) -> int:
    """The main lane with its number after a lane, or before it if `side` is -1; -1 for none."""
    first = road.lanes["first"]
    for other in np.nonzero(main & (np.arange(main.size) - first == lane - first[lane]))[0]:
        source, following = (lane, other) if side > 0 else (other, lane)
        if first[following] in roads_after(road, int(source)):
            return int(other)
    return -1


@compiled_of_scenes
def note(
    scenes: Scenes,
    rows: Ints,
    main: Bools,
    chains: NDArray[np.void],
    ends: Ints,
    table: NDArray[np.void],
) -> None:
    """See `Entries.note`; the rows of `chains` for a lane are before its place in `ends`."""
    dt = scenes.constants[0].dt
    for b in rows:
        entry = table[b]
        if entry.vehicle < 0:
            continue
        own = scenes.vehicles[b, entry.vehicle]
        if entry.lane < 0:
            if main[own.lane] and not own.crashed:
                enter(scenes, b, entry, chains, ends)
            continue
        if entry.follower < 0:
            continue
        entry.since_s += dt
        other = scenes.vehicles[b, entry.follower]
        if own.crashed or other.crashed:
            entry.meets, entry.follower = False, -1
            continue
        if entry.since_s <= IMPOSED_S + dt / 2:
            entry.entry_braking_mps2 = max(entry.entry_braking_mps2, -other.acceleration)
        if entry.meets:
            along = along_chain(scenes, b, entry.follower, entry.lane, chains, ends)
            entry.meets = not math.isnan(along) and entry.since_s - dt <= PET_LIMIT_S
            if entry.meets and along >= entry.place:
                pet = entry.since_s - dt
                pet += (entry.place - entry.last) / (along - entry.last) * dt
                if pet <= PET_LIMIT_S:
                    entry.entry_pet_s = pet
                entry.meets = False
            entry.last = along


@compiled
def enter(scenes: Scenes, b: int, entry: Any, chains: NDArray[np.void], ends: Ints) -> None:
    """Fills in an entry in the simulation step in which it happens."""
    own = scenes.vehicles[b, entry.vehicle]
    entry.lane, entry.since_s = own.lane, 0.0
    own_along, _ = local_coordinates(scenes.road, own.lane, own.x, own.y)
    ahead, behind = RANGE_M, RANGE_M
    for j in range(scenes.vehicles.shape[1]):
        other, lengths = scenes.vehicles[b, j], (own.length + scenes.vehicles[b, j].length) / 2
        if j == entry.vehicle or other.kind <= OBSTACLE:
            continue
        for k in range(ends[own.lane - 1] if own.lane > 0 else 0, ends[own.lane]):
            if chains[k].lane != other.lane:
                continue
            along, _ = local_coordinates(scenes.road, other.lane, other.x, other.y)
            distance = along + chains[k].offset - own_along
            if 0 <= distance <= ahead:
                ahead, entry.entry_lead_gap_m = distance, max(distance - lengths, 0.0)
            elif -behind <= distance < 0:
                behind, entry.entry_lag_gap_m = -distance, max(-distance - lengths, 0.0)
                entry.follower, entry.place = j, own_along - lengths
                entry.last = own_along + distance
                entry.meets = entry.last < entry.place
                entry.entry_braking_mps2 = max(0.0, -other.acceleration)


@compiled
def along_chain(
    scenes: Scenes, b: int, j: int, lane: int, chains: NDArray[np.void], ends: Ints
) -> float:
    """Where vehicle j is along a lane, m; not a number if it is on no lane of its chain.

    Of a ring that is shorter than the chain, the lanes before come first.
    """
    other = scenes.vehicles[b, j]
    for k in range(ends[lane - 1] if lane > 0 else 0, ends[lane]):
        if chains[k].lane == other.lane:
            along, _ = local_coordinates(scenes.road, other.lane, other.x, other.y)
            return float(along + chains[k].offset)
    return math.nan
