"""Whether there is room for a vehicle: where it changes lanes, and where it appears."""

import math

from charms_bench.foundation.arrays import Bools, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.locating import are_above, forget
from charms_bench.roads.safe_gap import is_safe
from charms_bench.roads.scenes import NOTHING, OBSTACLE, Here, Scenes, here_of, vehicle_of
from charms_bench.roads.stepping import are_apart, diagonal_of


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
