"""The types of the vehicles on a road: their sizes, for which there is room, and desired speeds."""

import math

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.type_draws import draw_vehicles
from charms_bench.foundation.arrays import Bools, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.locating import are_above, forget
from charms_bench.roads.safe_gap import is_safe
from charms_bench.roads.scenes import (
    ANY_SPEED_MPS,
    NOTHING,
    OBSTACLE,
    Here,
    Scenes,
    here_of,
    tidy_all,
    vehicle_of,
)
from charms_bench.roads.stepping import are_apart, diagonal_of
from charms_bench.world.scene import SceneSettings


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


def set_types(
    scenes: Scenes,
    settings: SceneSettings,
    egos: int,
    rows: Ints,
    seeds: NDArray[np.uint64],
    entry: Ints,
    is_new: Bools,
) -> None:
    """Gives new vehicles the sizes and the desired speeds of their types.

    One that comes later is not faster than its desired speed. A vehicle other than an ego that has
    no room then is taken out. `seeds` (R,) are those of the scenes `rows` (R,), and
    `entry` (R, N) and `is_new` (R, N) say the numbers of all vehicles, and which of them are new.
    """
    table = scenes.vehicles
    is_new = is_new & (table["kind"][rows] > OBSTACLE)
    is_ego = np.broadcast_to(np.arange(table.shape[1]) < egos, entry.shape)
    desired, length, width = draw_vehicles(settings, seeds, entry, is_ego)
    wants = is_new & ~np.isnan(desired)
    comes = wants & (entry >= table.shape[1])
    for name, values, where in (
        ("length", length, is_new),
        ("width", width, is_new),
        ("desired_speed", np.where(wants, desired, ANY_SPEED_MPS), is_new),
        ("target_speed", desired, wants & ~table["is_yielding"][rows]),
        ("speed", np.fmin(desired, table["speed"][rows]), comes),
    ):
        table[name][rows] = np.where(where, values, table[name][rows])
    take_out_crowded(scenes, rows, is_new & ~is_ego)
    tidy_all(scenes, rows)
