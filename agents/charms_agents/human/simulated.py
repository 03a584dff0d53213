"""Samples of simulated drivers, from which a prior is learnt where there are too few recordings.

Calibrated drivers drive the egos of simulated episodes. At each decision, a sample has what the
driver sees and the meta-action that comes closest to what it does: a lane command while it moves to
another lane, otherwise the action after which the speed is the nearest to the driver's
(`interface.through_interface`). With the option `commands`, the observation shows the commands that
the meta-actions before have led to.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl

from charms_agents.human.interface import through_interface
from charms_agents.human.samples import Samples
from charms_agents.human.soft_labels import columns_of
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.runs.shard import engine_on
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.interaction_observation import CHANGE_MPS, EGO, REPEATS, Interaction
from charms_bench.world.observations import (
    CHANGE_SCALE,
    COMMANDS,
    REPEATS_SCALE,
    NamedObservation,
    Neighbours,
)
from charms_bench.world.scene import Observations, SceneSettings

HELD_OUT = 0.1
"""Proportion of the episodes whose samples are kept from training."""
SETTLING_S = 2.0
"""The first part of an episode, in which drivers recover from the spawn, is left out."""
_EGO = "the driver"


def simulated_samples(
    drivers: Sequence[Agent],
    places: Sequence[tuple[SceneSettings, Traffic]],
    others: Mapping[str, Agent],
    episodes: int,
    first_seed: int,
    observation: NamedObservation,
    actions: Sequence[MetaAction] = DEFAULT_ACTIONS,
) -> Samples:
    """The samples of each of the drivers, as egos, in each of the places: scenes and traffics.

    `others` are all agents that the traffics name, by name. Each driver has `episodes` in each
    place, whose seeds count up from `first_seed`.
    """
    observed, chosen, held_out = [], [], []
    for driver in drivers:
        for scene, traffic in places:
            seeds = np.arange(first_seed, first_seed + episodes, dtype=np.uint64)
            agents = {**others, _EGO: driver}
            simulation = Simulation(scene, episodes, _EGO, traffic, agents, engine_on(scene))
            simulation.reset(seeds)
            seen, taken, running = _driven(simulation, observation, actions)
            last = np.arange(episodes) >= episodes - max(1, round(HELD_OUT * episodes))
            observed.append(seen[running])
            chosen.append(taken[running])
            held_out.append(np.broadcast_to(last, running.shape)[running])
            first_seed += episodes
    labels = np.eye(len(actions), dtype=np.float32)[np.concatenate(chosen)]
    return Samples(np.concatenate(observed), labels, np.concatenate(held_out), pl.DataFrame())


def _driven(
    simulation: Simulation, observation: NamedObservation, actions: Sequence[MetaAction]
) -> tuple[Observations, np.ndarray, np.ndarray]:
    """Observations (D, B, rows, columns), actions (D, B), and which of them are samples (D, B)."""
    scene, egos, now = simulation.settings, simulation.ego_vehicles, simulation.scene
    speeds, seen, running, lanes, targets = [now.speed[egos]], [], [], [], []
    for _ in range(scene.decisions):
        running.append(now.active.copy())
        seen.append(observation(*simulation.engine.seen_by(egos)))
        before = simulation.scene.lane[egos]
        simulation.step()
        now = simulation.scene
        # The numbers of lanes change from one road to the next.
        lanes.append(before if scene.network is None else now.lane[egos])
        speeds.append(now.speed[egos])
        targets.append(now.target_lane[egos])
    driven = through_interface(np.array(speeds), scene.profile, actions)
    observed, lane, target = np.array(seen), np.array(lanes), np.array(targets)
    if isinstance(observation, Interaction):
        own = observed[:, :, EGO]
        own[..., 1] = ((driven.target_speed - driven.speed[:-1]) / CHANGE_MPS).clip(-1, 1)
        own[..., 2] = (driven.repeats / REPEATS).clip(-1, 1)
        own[..., 3] = (driven.acceleration / CHANGE_MPS).clip(-1, 1)
        before = np.zeros((observation.delay_decisions, *observed.shape[1:]), observed.dtype)
        since = np.concatenate([before, observed]).swapaxes(0, 1)  # the start of the episodes
        observed = observation.delayed(since).swapaxes(0, 1)
    elif isinstance(observation, Neighbours) and observation.commands:
        commands = observed[:, :, COMMANDS]
        commands[..., 0] = (driven.target_speed - driven.speed[:-1]) / CHANGE_SCALE
        commands[..., 1] = driven.repeats / REPEATS_SCALE
        commands[..., 3] = driven.acceleration / CHANGE_SCALE
    columns = columns_of(actions)
    taken = np.where(target < lane, columns.left, driven.actions)
    taken = np.where(target > lane, columns.right, taken)
    is_sample = np.array(running)
    is_sample[: round(SETTLING_S * scene.decision_hz)] = False
    return observed, taken, is_sample
