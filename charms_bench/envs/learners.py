"""Several vehicles of each scene that the caller drives, until each crashes or leaves the road."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import index
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.collisions import NO_COLLISION, SIDE_COLLISION
from charms_bench.engine.endings import OFF_ROAD, REAR_END, RUNNING, SIDE, TIME, are_off_road
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Bools, Floats, Ints, Scene, SceneSettings, Vehicles

VehicleReward = Callable[[Scene, Vehicles], Floats]
"""The rewards (M,) of M vehicles after a decision interval."""


class Outcome(NamedTuple):
    """What a decision interval did to the learners, [B, L]."""

    rewards: Floats
    """0 for a learner that did not drive any more."""
    terminated: Bools
    """Whether the learner has crashed or left the road in this interval."""
    truncated: Bools
    """Whether the scene's time is over while the learner drives."""
    endings: Ints
    """Index into `ENDINGS`; `RUNNING` unless the learner ended in this interval."""


class Learners:
    """L vehicles in each of B scenes, which the actions given to `step` drive.

    Vehicle 0 is the ego, and vehicle k is the k-th of the others in the order of spawning. A
    learner that has crashed, or has left the road if the profile ends episodes then, gets no more
    actions. Its vehicle stays in the scene, which goes on for the others until its time is over.

    Args:
        settings: What the scenes have in common.
        scenes: B.
        numbers: The learners' vehicles, which include 0; None for all vehicles.
        traffic: Assigns a driver to each vehicle that is not a learner.
        agents: All agents that `traffic` names, by name.
        reward: The reward of a decision.

    Raises:
        InputError: A number is not that of a vehicle, or it is given twice, or 0 is missing; or
            there is no scene.
    """

    def __init__(
        self,
        settings: SceneSettings,
        scenes: int,
        numbers: Iterable[int] | None,
        traffic: Traffic,
        agents: Mapping[str, Agent],
        reward: VehicleReward,
    ) -> None:
        if scenes < 1:
            raise InputError(f"scenes is {scenes}; expected at least 1")
        everyone = range(settings.vehicles)
        self.numbers = _checked(everyone if numbers is None else numbers, settings.vehicles)
        shape = (scenes, len(self.numbers))
        self.places = np.zeros(shape, dtype=np.int64)
        """[B, L] the learners' places in their scenes, in the order of spawning."""
        self.alive = np.zeros(shape, dtype=np.bool_)
        """[B, L] whether the learner drives, so that its next action counts."""
        self.returns = np.zeros(shape)
        """[B, L] sums of the rewards so far."""
        are_all = len(self.numbers) == settings.vehicles
        driven = OneAgent("") if are_all else FromOutside(self.numbers, traffic)
        self.simulation = Simulation(settings, scenes, None, driven, agents)
        self._reward = reward

    @property
    def vehicles(self) -> Vehicles:
        """The M learners that drive, by scene and then in the order of `numbers`."""
        rows, which = np.nonzero(self.alive)
        return rows, self.places[rows, which]

    def reset(self, seeds: NDArray[np.uint64], rows: Ints) -> None:
        """Starts an episode in each of the scenes `rows`, in which all learners drive."""
        self.simulation.reset(seeds, rows)
        ego = self.simulation.scene.ego[rows, None]
        others = np.array(self.numbers) - 1
        self.places[rows] = np.where(others < 0, ego, others + (others >= ego))
        self.alive[rows] = True
        self.returns[rows] = 0.0

    def step(self, actions: Actions) -> Outcome:
        """Carries out the actions [B, L] of the learners that drive for one decision interval."""
        simulation, alive, vehicles = self.simulation, self.alive.copy(), self.vehicles
        scene = simulation.scene
        simulation.command(vehicles, actions[alive])
        simulation.step()
        rewards = np.zeros(alive.shape)
        rewards[alive] = self._reward(scene, vehicles)
        self.returns += rewards
        collision = simulation.collision[vehicles]
        ending = np.where(simulation.truncated[vehicles[0]], TIME, RUNNING)
        if simulation.settings.profile.offroad_terminal:
            ending[are_off_road(scene, *vehicles)] = OFF_ROAD
        ending[collision != NO_COLLISION] = REAR_END
        ending[collision == SIDE_COLLISION] = SIDE
        endings = np.full(alive.shape, RUNNING)
        endings[alive] = ending
        truncated = endings == TIME
        terminated = (endings != RUNNING) & ~truncated
        self.alive &= endings == RUNNING
        return Outcome(rewards, terminated, truncated, endings)


class FromOutside(Traffic):
    """A traffic in which some vehicles have no agent, because the caller drives them.

    Args:
        numbers: These vehicles; see `Learners`. The ego is no part of a traffic.
        traffic: Assigns a driver to each of the other vehicles: the same one as without learners.
    """

    def __init__(self, numbers: Sequence[int], traffic: Traffic) -> None:
        self.agents = ("", *traffic.agents)
        self._traffic = traffic
        self._driven = [number - 1 for number in numbers if number > 0]

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        assigned = np.array(self._traffic.assign(rng, scenes, vehicles))
        assigned[:, self._driven] = ""
        return assigned


def _checked(numbers: Iterable[int], vehicles: int) -> tuple[int, ...]:
    """The learners' numbers in ascending order."""
    try:
        found = sorted(index(number) for number in numbers)
    except TypeError:
        found = []
    if not found or found[0] != 0 or found[-1] >= vehicles or len({*found}) < len(found):
        shown = ", ".join(map(str, found[:20])) + ", ..." * (len(found) > 20) or f"{numbers!r:.80}"
        raise InputError(
            f"learners: found {shown}; expected different numbers from 0 to {vehicles - 1}, of "
            f"which one is 0, the ego, such as range({min(3, vehicles)})"
        )
    return tuple(found)
