"""What a network sees while it drives, which fine-tuning rehearses so as not to forget it."""

from collections.abc import Mapping

import numpy as np
import torch
from torch.nn import Sequential

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import ACTIONS
from charms_bench.world.observations import neighbours
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
) -> Observations:
    """(M, 7, 5) the observations at all decisions of `EPISODES` episodes with the network as ego.

    Args:
        network: Takes plain observations.
        scene: The scene of the episodes.
        traffic: Assigns a driver to each of the other vehicles.
        drivers: All agents that `traffic` names, by name.
        first_seed: Seed of the first episode; each further episode adds 1.
    """
    simulation = Simulation(scene, EPISODES, None, traffic, drivers)
    simulation.reset(np.arange(first_seed, first_seed + EPISODES, dtype=np.uint64))
    rng, seen = np.random.default_rng(first_seed), []
    running = simulation.scene.active
    while running.any():
        rows = np.flatnonzero(running)
        observations = neighbours(simulation.scene, (rows, simulation.scene.ego[rows]))
        with torch.no_grad():
            best = network(torch.from_numpy(observations).flatten(1)).numpy().argmax(axis=1)
        explores = rng.random(rows.size) < EXPLORATION
        actions = np.zeros(EPISODES, dtype=np.int64)
        actions[rows] = np.where(explores, rng.integers(len(ACTIONS), size=rows.size), best)
        simulation.step(actions)
        seen.append(observations)
    return np.concatenate(seen)
