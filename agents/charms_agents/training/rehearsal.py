"""A network drives episodes, for fine-tuning to rehearse."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch.nn import Sequential

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.observations import NamedObservation
from charms_bench.world.scene import Observations, SceneSettings

EPISODES = 1_500
EXPLORATION = 0.02
"""Probability of a random action, which adds states off the network's usual path."""


def own_driving(
    network: Sequential,
    places: Sequence[tuple[SceneSettings, Traffic]],
    drivers: Mapping[str, Agent],
    first_seed: int,
    observation: NamedObservation,
    meta_actions: tuple[MetaAction, ...] = DEFAULT_ACTIONS,
) -> Observations:
    """(M, rows, columns) the observations at all decisions of `EPISODES` episodes.

    The network, which takes plain observations, drives the egos; each place, a scene and a traffic
    of some of `drivers`, has equally many episodes. Their seeds count up from `first_seed`.
    """
    rng = np.random.default_rng(first_seed)
    observed: list[Observations] = []
    for scene, traffic in places:
        episodes = EPISODES // len(places)
        simulation = Simulation(scene, episodes, None, traffic, drivers, actions=meta_actions)
        simulation.reset(np.arange(first_seed, first_seed + episodes, dtype=np.uint64))
        first_seed += episodes
        running = simulation.scene.active
        while running.any():
            rows = np.flatnonzero(running)
            seen = observation(simulation.scene, (rows, simulation.scene.ego[rows]))
            with torch.no_grad():
                best = network(torch.from_numpy(seen).flatten(1)).numpy().argmax(axis=1)
            explores = rng.random(best.size) < EXPLORATION
            actions = np.zeros(running.size, dtype=np.int64)
            explored = rng.integers(len(meta_actions), size=best.size)
            actions[rows] = np.where(explores, explored, best)
            simulation.step(actions)
            observed.append(seen)
    return np.concatenate(observed)
