"""The parameters in which the drivers of one model differ, `Scene.parameters`.

They follow from an episode's seed and its drivers, so a state needs no copy of them.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from charms_bench.engine.type_draws import draw_types
from charms_bench.world.placement import driver_parameters
from charms_bench.world.scene import Ints

if TYPE_CHECKING:
    from charms_bench.engine.simulation import Simulation

Ranges = Mapping[str, tuple[float, float]]
_STREAM = 3
"""The random stream of a seed that draws parameters; see `Simulation.reset` for another."""


def set_parameters(simulation: "Simulation", rows: Ints) -> None:
    """Sets the parameters of the drivers in the scenes `rows` (R,).

    They are independent, and uniform in the ranges that the vehicle's type gives or else their
    model declares. In a scenario, nothing is left to chance: they are the middles of the ranges, or
    what the scenario gives.
    """
    if not simulation.ranges:
        return
    settings, seeds, entry = simulation.settings, simulation.seeds[rows], simulation.scene.entry
    kinds, _ = draw_types(settings, seeds, entry[rows], simulation.scene.ego[rows])
    given = [*(each.driver_parameters for each in settings.vehicle_types), {}]
    for agent, ranges in simulation.ranges.items():
        name = simulation.agents[agent].encode()
        of_kinds = np.array([[own.get(k, each) for k, each in ranges.items()] for own in given])
        for row, kind in zip(rows, kinds, strict=True):
            shares = np.full((settings.vehicles, len(ranges)), 0.5)
            if settings.scenario is None:
                # Each model has its own random stream: other drivers do not change the draws.
                rng = np.random.default_rng([int(simulation.seeds[row]), _STREAM, crc32(name)])
                shares = rng.random((entry[row].max() + 1, len(ranges)))[entry[row]]
            own = simulation.engine.drivers[row] == agent
            low, high = np.moveaxis(of_kinds[kind[own]], -1, 0)
            drawn = low + (high - low) * shares[own]
            simulation.scene.parameters[row, own, : len(ranges)] = drawn
        _set_given(simulation, rows, agent, ranges)


def _set_given(simulation: "Simulation", rows: Ints, agent: int, ranges: Ranges) -> None:
    """Sets the parameters that a scenario gives to vehicles of an agent."""
    scenario, drivers = simulation.settings.scenario, simulation.engine.drivers
    for k, vehicle in enumerate(scenario.vehicles if scenario is not None else ()):
        own = rows[drivers[rows, k + 1] == agent]
        if scenario is None or vehicle.agent != simulation.agents[agent] or not own.size:
            continue
        numbers = simulation.seeds[own]
        given = driver_parameters(scenario, k, simulation.scene.constants, ranges, numbers)
        for name, values in given.items():
            simulation.scene.parameters[own, k + 1, list(ranges).index(name)] = values
