"""The types of the vehicles on a road: their sizes and their desired speeds."""

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.type_draws import draw_vehicles
from charms_bench.foundation.arrays import Bools, Ints
from charms_bench.roads.room import take_out_crowded
from charms_bench.roads.scenes import ANY_SPEED_MPS, OBSTACLE, Scenes, tidy_all
from charms_bench.world.scene import SceneSettings


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
    no room then is taken out; see `room`. `seeds` (R,) are those of the scenes `rows` (R,), and
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
