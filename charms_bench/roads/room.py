"""Whether there is room for a vehicle: where it changes lanes, and where it appears."""

import math

from charms_bench.foundation.arrays import Bools, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.locating import are_above, coordinates_of, forget
from charms_bench.roads.order import neighbours
from charms_bench.roads.scenes import NOTHING, OBSTACLE, Here, Scenes, here_of, vehicle_of
from charms_bench.roads.stepping import are_apart, diagonal_of
from charms_bench.world.gaps import gap_to, is_within, requires_braking
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2

HEADWAY_S = 0.3
"""The least time headway."""


@compiled
def is_safe(here: Here, i: int, lane: int) -> bool:
    """Whether on a lane, neither vehicle i nor its follower has to brake hard to avoid a collision.

    The deceleration that just avoids one is at most `DRAC_LIMIT_MPS2`, and the time headway at
    least `HEADWAY_S`.
    """
    front, rear = neighbours(here, i, lane)
    for behind, ahead in ((i, front), (rear, i)):
        if behind < 0 or ahead < 0:
            continue
        own, other = vehicle_of(here, behind), vehicle_of(here, ahead)
        distance = coordinates_of(here, ahead, lane).s - coordinates_of(here, behind, lane).s
        gap, closing = gap_to(distance, own.length, other.length), own.speed - other.speed
        is_close = is_within(gap, own.speed, HEADWAY_S)
        if is_close or requires_braking(gap, closing, DRAC_LIMIT_MPS2):
            return False
    return True


@compiled
def touches(here: Here, i: int) -> bool:
    """Whether vehicle i overlaps another vehicle or an obstacle."""
    own = vehicle_of(here, i)
    for j in range(here.places):
        other = vehicle_of(here, j)
        if j == i or other.kind < OBSTACLE or are_above(here, own.lane, other.lane):
            continue
        dx, dy = other.x - own.x, other.y - own.y
        if math.sqrt(dx * dx + dy * dy) > (diagonal_of(own) + diagonal_of(other)) / 2:
            continue
        if not are_apart(own, other, 0.0, 0.0) and not are_apart(other, own, 0.0, 0.0):
            return True
    return False


@compiled_of_scenes
def take_out_crowded(scenes: Scenes, rows: Ints, is_new: Bools) -> None:
    """Takes those of some vehicles (R, N) out of the scenes `rows` (R,) that have no room."""
    for r in range(rows.size):
        here = here_of(scenes, rows[r])
        for i in range(here.places):
            forget(here, i)
        for i in range(here.places):
            vehicle = vehicle_of(here, i)
            if is_new[r, i] and (touches(here, i) or not is_safe(here, i, vehicle.lane)):
                vehicle.kind = NOTHING
                forget(here, i)  # so that its neighbours are found anew
