"""A network drives episodes: for fine-tuning to rehearse, and for validation."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import Sequential

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import ACTIONS
from charms_bench.world.observations import Neighbours, neighbours
from charms_bench.world.scene import Observations, SceneSettings

EPISODES = 1_500
EXPLORATION = 0.02
"""Probability of a random action, so that the network is also seen beside its usual path."""


def own_driving(
    network: Sequential,
    scene: SceneSettings,
    traffic: Traffic,
    drivers: Mapping[str, Agent],
    first_seed: int,
    observation: Neighbours = neighbours,
) -> Observations:
    """(M, 7, 5) the observations at all decisions of `EPISODES` episodes with the network as ego.

    Args:
        network: Takes plain observations.
        traffic: Assigns one of `drivers` to each of the other vehicles.
        drivers: All agents that `traffic` names, by name.
        first_seed: Seed of the first episode; each further episode adds 1.
    """
    simulation = Simulation(scene, EPISODES, None, traffic, drivers)
    simulation.reset(np.arange(first_seed, first_seed + EPISODES, dtype=np.uint64))
    rng = np.random.default_rng(first_seed)

    def explore(best: NDArray[np.int64]) -> NDArray[np.int64]:
        explores = rng.random(best.size) < EXPLORATION
        return np.where(explores, rng.integers(len(ACTIONS), size=best.size), best)

    return np.concatenate(list(drive(network, simulation, explore, observation)))


def drive(
    network: Sequential,
    simulation: Simulation,
    explore: Callable[[NDArray[np.int64]], NDArray[np.int64]] = lambda best: best,
    observation: Neighbours = neighbours,
) -> Iterator[Observations]:
    """Drives the egos of a simulation, which have no agent, to the end of all episodes.

    The network takes plain observations, and `explore` turns its actions (K,) of one decision into
    those that are taken.

    Yields:
        After each step, the observations (K, 7, 5) of the K egos that decided.
    """
    running = simulation.scene.active
    while running.any():
        rows = np.flatnonzero(running)
        observations = observation(simulation.scene, (rows, simulation.scene.ego[rows]))
        with torch.no_grad():
            best = network(torch.from_numpy(observations).flatten(1)).numpy().argmax(axis=1)
        actions = np.zeros(running.size, dtype=np.int64)
        actions[rows] = explore(best)
        simulation.step(actions)
        yield observations
