"""The parameters in which the drivers of one model differ, `Scene.parameters`.

They follow from an episode's seed and its drivers, so a state needs no copy of them.
"""

from zlib import crc32

import numpy as np

from charms_bench.engine.running import Ranges, RunningEpisodes
from charms_bench.engine.type_draws import draw_types, vehicles_at
from charms_bench.world.placement import driver_parameters
from charms_bench.world.scene import Ints
from charms_bench.world.vehicle_types import OF_VEHICLES, VehicleType, drawn_from

_STREAM = 3
"""The random stream of a seed that draws parameters; see `RunningEpisodes.seats_of` for another."""


def set_parameters(episodes: RunningEpisodes, rows: Ints, places: Ints | None = None) -> None:
    """Sets the parameters of the drivers in the scenes `rows` (R,): all, or one place (R,) of each.

    By default, they are independent, and uniform in the ranges that their model declares; the type
    of a vehicle can give other distributions. In a scenario, nothing is left to chance: they are
    the middles of the ranges, or what the scenario gives.
    """
    if not episodes.ranges:
        return
    settings, seeds, scene = episodes.settings, episodes.seeds[rows], episodes.scene
    at, is_ego = vehicles_at(scene, rows, places)
    if episodes.engine.egos > 1:
        is_ego = np.broadcast_to(at[1] < episodes.engine.egos, is_ego.shape)
    entry, drivers = scene.entry[at], episodes.engine.drivers[at]
    kinds, of_vehicles = draw_types(settings, seeds, entry, is_ego)
    types = (*settings.vehicle_types, VehicleType(name="profile", share=1.0))
    for agent, ranges in episodes.ranges.items():
        own_stream = crc32(episodes.agents[agent].encode())
        uniforms = np.full((*entry.shape, len(ranges)), 0.5)
        for r, seed in enumerate(seeds if settings.scenario is None else ()):
            # Each model has its own random stream: other drivers do not change the draws.
            source = np.random.PCG64([int(seed), _STREAM, own_stream])
            first = entry[r].min()
            rng = np.random.Generator(source.advance(int(first) * len(ranges)))
            numbers = rng.random((entry[r].max() + 1 - first, len(ranges)))
            uniforms[r] = numbers[entry[r] - first]
        for k, each in enumerate(types):
            own = (drivers == agent) & (kinds == k)
            independent = np.hstack([of_vehicles[own], uniforms[own]])
            of_type = each.correlated((*OF_VEHICLES, *ranges), independent)
            for n, (name, default) in enumerate(ranges.items()):
                value = each.driver_parameters.get(name, default)
                rows_of, places_of = (np.broadcast_to(k, own.shape)[own] for k in at)
                drawn = drawn_from(value, of_type[:, len(OF_VEHICLES) + n])
                scene.parameters[rows_of, places_of, n] = drawn
        _set_given(episodes, rows, agent, ranges)


def _set_given(episodes: RunningEpisodes, rows: Ints, agent: int, ranges: Ranges) -> None:
    """Sets the parameters that a scenario gives to vehicles of an agent."""
    settings, drivers = episodes.settings, episodes.engine.drivers
    scenario = settings.scenario
    for k, vehicle in enumerate(scenario.vehicles if scenario is not None else ()):
        own = rows[drivers[rows, k + 1] == agent]
        if scenario is None or vehicle.agent != episodes.agents[agent] or not own.size:
            continue
        numbers = episodes.seeds[own]
        given = driver_parameters(scenario, k, settings, ranges, numbers)
        for name, values in given.items():
            episodes.scene.parameters[own, k + 1, list(ranges).index(name)] = values
