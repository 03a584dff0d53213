"""Which vehicle is of which type, and what follows: its size and its desired speed.

Types follow from an episode's seed and the ego's place, so a state needs no copy of them.
"""

import numpy as np
from numpy.typing import NDArray

from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings, Vehicles
from charms_bench.world.vehicle_types import OF_VEHICLES, drawn_from

_STREAM = 4
"""The random stream of a seed that draws types; see `engine.parameters` for another."""


def draw_types(
    settings: SceneSettings, seeds: NDArray[np.uint64], entry: Ints, is_ego: NDArray[np.bool_]
) -> tuple[Ints, Floats]:
    """Draws the types (R, M) of M vehicles in each of R scenes, and the places in their ranges.

    A type is an index into `vehicle_types`; the index after the last stands for the profile's
    vehicle, which vehicles are that enter a straight road later without an inflow. The second array
    (R, M, 3) has independent numbers in [0, 1) for the quantities `OF_VEHICLES`. `entry` (R, M) are
    those of the scene.
    """
    types, vehicles = settings.vehicle_types, settings.vehicles
    kinds = np.full(entry.shape, len(types))
    uniforms = np.zeros((*entry.shape, len(OF_VEHICLES)))
    if not types:
        return kinds, uniforms
    ends = np.cumsum([each.share for each in types])[:-1]
    for r, seed in enumerate(seeds):
        rng = np.random.default_rng([int(seed), _STREAM])
        drawn = np.searchsorted(ends, rng.random(vehicles), side="right")
        at_start = entry[r] < vehicles
        kinds[r, at_start] = drawn[entry[r, at_start]]
        for k in range(len(OF_VEHICLES)):
            uniforms[r, at_start, k] = rng.random(vehicles)[entry[r, at_start]]
        for m in np.nonzero(~at_start)[0] if settings.inflow or settings.network else ():
            rng = np.random.default_rng([int(seed), _STREAM, int(entry[r, m])])
            kinds[r, m] = np.searchsorted(ends, rng.random(), side="right")
            uniforms[r, m] = rng.random(len(OF_VEHICLES))
    names = [*(each.name for each in types), None]
    kinds[is_ego] = names.index(settings.ego_type)
    return kinds, uniforms


def draw_vehicles(
    settings: SceneSettings, seeds: NDArray[np.uint64], entry: Ints, is_ego: NDArray[np.bool_]
) -> tuple[Floats, Floats, Floats]:
    """The desired speeds, lengths and widths (R, M) of M vehicles in each of R scenes; SI units.

    The speed is NaN for a vehicle that wants the speed at which it starts.
    """
    profile = settings.profile
    sizes = profile.vehicle_length_m, profile.vehicle_width_m
    desired, length, width = (np.full(entry.shape, value) for value in (np.nan, *sizes))
    kinds, uniforms = draw_types(settings, seeds, entry, is_ego)
    for k, each in enumerate(settings.vehicle_types):
        own = kinds == k
        found = each.correlated(OF_VEHICLES, uniforms[own])
        values = (each.desired_speed_mps, each.length_m, each.width_m)
        for n, (array, value) in enumerate(zip((desired, length, width), values, strict=True)):
            if value is not None:
                array[own] = drawn_from(value, found[:, n])
    return desired, length, width


def set_types(
    scene: Scene, settings: SceneSettings, rows: Ints, seeds: NDArray[np.uint64]
) -> Floats:
    """Sets the sizes of the vehicles of the scenes `rows` (R,), whose egos are set already.

    Returns their desired speeds (R, N); see `draw_vehicles`.
    """
    at, is_ego = vehicles_at(scene, rows)
    desired, length, width = draw_vehicles(settings, seeds, scene.entry[at], is_ego)
    if settings.vehicle_types:
        scene.length[at], scene.width[at] = length, width
    return desired


def vehicles_at(
    scene: Scene, rows: Ints, places: Ints | None = None
) -> tuple[Vehicles, NDArray[np.bool_]]:
    """All vehicles of the scenes `rows` (R,), or one of each, as an index (R, M); and the egos."""
    everyone = np.arange(scene.x.shape[1])[None]
    at = (rows[:, None], everyone if places is None else places[:, None])
    return at, at[1] == scene.ego[rows][:, None]
