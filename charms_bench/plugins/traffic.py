"""The plugin contract of a traffic, which assigns an agent to each vehicle around the ego.

A traffic is registered in the entry-point group `charms_bench.traffic`. Every agent's name is also
the name of a traffic in which that agent drives every vehicle.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import PLUGIN_ERRORS, AgentError, BrokenWordError, InputError, raised

SAMPLED = 200_000
"""Vehicles of which `proportions` counts the agents: the standard error is at most 0.11 %."""


class Traffic(ABC):
    """Assigns an agent to every vehicle of the traffic."""

    agents: tuple[str, ...]
    """The names of all agents that `assign` may return, in the order in which they act."""

    after_deviation: str = ""
    """In a scene of recordings, the agent that takes over the vehicles that follow the recording,
    once the ego is `engine.playback.DEVIATION_M` away from its recorded position."""

    @abstractmethod
    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        """The agents' names, (scenes, vehicles), in the order of spawning without the ego."""


def assigned(
    traffic: Traffic, rng: np.random.Generator, scenes: int, vehicles: int
) -> NDArray[np.str_]:
    """What `assign` returns; raises a `BrokenWordError` unless it is names from `agents`."""
    names = np.asarray(traffic.assign(rng, scenes, vehicles))
    if names.shape != (scenes, vehicles):
        raise BrokenWordError(
            f"assign returned shape {names.shape}; expected ({scenes}, {vehicles})"
        )
    names = names.astype(str)
    if unknown := set(names.ravel().tolist()) - set(traffic.agents):
        raise BrokenWordError(f"assign returned '{min(unknown)}', which `agents` does not list")
    return names


def proportions(traffic: Traffic) -> dict[str, float]:
    """The proportion of each agent among `SAMPLED` vehicles, in the traffic's order."""
    try:
        names = assigned(traffic, np.random.default_rng(0), SAMPLED // 20, 20)
    except BrokenWordError as error:
        raise AgentError(f"the traffic: {error}") from error
    except PLUGIN_ERRORS as error:
        raise AgentError(f"the traffic {raised(error)}") from error
    return {name: float((names == name).mean()) for name in traffic.agents}


class OneAgent(Traffic):
    """One agent drives every vehicle."""

    def __init__(self, agent: str) -> None:
        self.agents = (agent,)

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        return np.full((scenes, vehicles), self.agents[0])


class Placed(Traffic):
    """The vehicles of a scenario, each with its own agent; see `world.scenario`."""

    def __init__(self, agents: Sequence[str]) -> None:
        self.agents = tuple(dict.fromkeys(agents))
        self._by_vehicle = np.array(agents)

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        there_is_room_for = vehicles - self._by_vehicle.size  # on a road with more places
        everyone = np.pad(self._by_vehicle, (0, there_is_room_for), mode="edge")
        return np.tile(everyone, (scenes, 1))


class Mixture(Traffic):
    """Draws the agent of every vehicle independently, with fixed probabilities.

    Args:
        composition: The proportion of each agent, by name; they sum to 1.

    Raises:
        InputError: A proportion is negative or not a number, or the proportions do not sum to 1.
    """

    def __init__(self, composition: Mapping[str, float]) -> None:
        self.agents = tuple(composition)
        try:
            self._proportions = np.array([float(each) for each in composition.values()])
        except (TypeError, ValueError):
            self._proportions = np.array([np.nan])
        if not ((self._proportions >= 0).all() and abs(self._proportions.sum() - 1) <= 1e-9):
            what = "the proportions of agents must be non-negative and sum to 1"
            raise InputError(f"{what}, got {dict(composition)}")

    def __repr__(self) -> str:
        return f"Mixture({dict(zip(self.agents, self._proportions.tolist(), strict=True))})"

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        return rng.choice(np.array(self.agents), size=(scenes, vehicles), p=self._proportions)
