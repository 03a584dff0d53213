"""Which vehicle is of which type, and what follows: its size and its desired speed.

Types follow from an episode's seed and the ego's place, so a state needs no copy of them.
"""

import numpy as np
from numpy.typing import NDArray

from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings

_STREAM = 4
"""The random stream of a seed that draws types; see `engine.parameters` for another."""


def draw_types(
    settings: SceneSettings, seeds: NDArray[np.uint64], entry: Ints, egos: Ints
) -> tuple[Ints, Floats]:
    """Draws the types (R, N) of the vehicles of R scenes, and where their desired speeds lie.

    A type is an index into `vehicle_types`; the index after the last stands for the profile's
    vehicle, which vehicles are that enter later. The second array has numbers in [0, 1), from the
    lowest desired speed to the highest. `entry` (R, N) are those of the scene.
    """
    types, shape = settings.vehicle_types, (seeds.size, settings.vehicles)
    kinds, shares = np.full(shape, len(types)), np.zeros(shape)
    if not types:
        return kinds, shares
    ends = np.cumsum([each.share for each in types])[:-1]
    for r, seed in enumerate(seeds):
        rng = np.random.default_rng([int(seed), _STREAM])
        drawn = np.searchsorted(ends, rng.random(settings.vehicles), side="right")
        at_start = entry[r] < settings.vehicles
        kinds[r, at_start] = drawn[entry[r, at_start]]
        shares[r, at_start] = rng.random(settings.vehicles)[entry[r, at_start]]
    names = [*(each.name for each in types), None]
    kinds[np.arange(seeds.size), egos] = names.index(settings.ego_type)
    return kinds, shares


def set_types(
    scene: Scene, settings: SceneSettings, rows: Ints, seeds: NDArray[np.uint64]
) -> Floats:
    """Sets the sizes of the vehicles of the scenes `rows` (R,), whose egos are set already.

    Returns:
        Their desired speeds (R, N), m/s; NaN for a vehicle that wants the speed at which it starts.
    """
    if not settings.vehicle_types:
        return np.full((rows.size, settings.vehicles), np.nan)
    kinds, shares = draw_types(settings, seeds, scene.entry[rows], scene.ego[rows])
    sizes = np.array(settings.sizes_m)[kinds]
    scene.length[rows], scene.width[rows] = sizes[..., 0], sizes[..., 1]
    speeds = [*(each.desired_speed_mps for each in settings.vehicle_types), None]
    low, high = np.moveaxis(np.array([each or (np.nan, np.nan) for each in speeds])[kinds], -1, 0)
    return np.asarray(low + (high - low) * shares)
