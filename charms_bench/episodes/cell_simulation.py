"""Simulations of a run's cell, in which more agents may be seated."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.specs import drivers_of, networks_of
from charms_bench.plugins.traffic import Traffic
from charms_bench.runs.finished import FinishedRun
from charms_bench.world.scene import SceneSettings

Networks = Mapping[str, Path]
"""The files of a cell's networks; see `specs.networks_of`."""


def simulation_of(
    run: FinishedRun,
    cell: int,
    scenes: int,
    folder: Path,
    guests: Mapping[str, Agent] = MappingProxyType({}),
    settings: SceneSettings | None = None,
    is_ego_outside: bool = False,
) -> Simulation:
    """A simulation of a cell's scenes, in which guests may be seated.

    Args:
        run: A finished run.
        cell: The index of the cell.
        scenes: How many scenes.
        folder: Where relative paths of networks in the suite start.
        guests: Agents beside those of the cell, by name; they act after these.
        settings: Other settings than the suite's.
        is_ego_outside: Whether the actions given to `Simulation.step` drive the ego.

    Raises:
        CharmsBenchError: An agent cannot be made.
    """
    ego, traffic = run.suite.cells[cell].ego.agent, run.suite.cells[cell].traffic.traffic.make()
    networks = networks_in(run, cell, folder)
    agents = {driver.key: driver.make(networks) for driver in drivers_of(ego, traffic)}
    return Simulation(
        settings or run.suite.cells[cell].scene,
        scenes,
        None if is_ego_outside else ego.key,
        _WithGuests(traffic, tuple({**agents, **guests})) if guests or is_ego_outside else traffic,
        {**guests, **agents},
    )


class _WithGuests(Traffic):
    """A traffic in which more agents may be seated."""

    def __init__(self, traffic: Traffic, agents: tuple[str, ...]) -> None:
        self.agents = agents
        self._traffic = traffic

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        return self._traffic.assign(rng, scenes, vehicles)


def drivers_in(run: FinishedRun, cell: int) -> set[str]:
    """The names of the agents that drive in a cell."""
    entry = run.suite.cells[cell]
    return {driver.key for driver in drivers_of(entry.ego.agent, entry.traffic.traffic.make())}


def networks_in(run: FinishedRun, cell: int, folder: Path) -> Networks:
    """Returns the files of the cell's networks: the copies in the run folder, if it has them."""
    ego, traffic = run.suite.cells[cell].ego.agent, run.suite.cells[cell].traffic.traffic.make()
    given = networks_of(ego, traffic, folder)
    return {name: run.folder.network(name) or path for name, path in given.items()}
