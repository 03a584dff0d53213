"""An episode to watch while it is simulated."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from charms_bench.engine.endings import ENDINGS
from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import made_traffic
from charms_bench.envs.rendering import moment_of
from charms_bench.plugins.registry import make_agent
from charms_bench.world.scene import SceneSettings

if TYPE_CHECKING:
    from charms_bench.world.picture import Moment


def plain(agent: str, traffic: str) -> Simulation:
    """Scenes with an agent as the ego, which is the name of one or the path of a network.

    Raises:
        CharmsBenchError: An agent or the traffic model cannot be used.
    """
    around, drivers = made_traffic(traffic)
    drivers[agent] = make_agent(agent)
    return Simulation(SceneSettings(), 1, agent, around, drivers)


class Watched:
    """An episode of a simulation of one scene."""

    def __init__(self, simulation: Simulation, seed: int, title: str) -> None:
        self.settings = simulation.settings
        self._title, self._simulation = title, simulation
        self._simulation.reset(np.array([seed], dtype=np.uint64))

    def moments(self) -> "Iterator[Moment]":
        """The start of the episode, and then the moment after each simulation step."""
        simulation = self._simulation
        yield moment_of(simulation, 0, self._title)
        while simulation.scene.active[0]:
            for _ in range(self.settings.steps_per_decision):
                simulation.advance()
                if simulation.phase < self.settings.steps_per_decision:
                    yield moment_of(simulation, 0, self._title)
            simulation.finish_step()
            yield moment_of(simulation, 0, self._title)

    @property
    def ending(self) -> str:
        """One of `engine.simulation.ENDINGS`."""
        return ENDINGS[self._simulation.ending[0]]
