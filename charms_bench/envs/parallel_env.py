"""Many learners as a PettingZoo `ParallelEnv`; it needs the extra `pettingzoo`."""

from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from operator import index
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from charms_bench.engine.endings import ENDINGS, RUNNING
from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import TrafficLike, surroundings
from charms_bench.envs.given_actions import MetaLike
from charms_bench.envs.highway_reward import highway_rewards
from charms_bench.envs.learners import Learners, VehicleReward
from charms_bench.envs.rendering import RENDER_MODES
from charms_bench.envs.seeds import checked_seed
from charms_bench.errors import InputError
from charms_bench.world.observations import ObservationLike, observation_of
from charms_bench.world.scene import EVALUATION_SEEDS, Ints, Observations, Vehicles

try:
    from pettingzoo import ParallelEnv as ParallelEnv
except ImportError as error:
    needed = f"a ParallelEnv needs PettingZoo ({error}); pip install 'charms-bench[pettingzoo]'"
    raise ImportError(needed, name="pettingzoo") from error

Step = tuple[
    dict[str, Observations],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


class NamedAgents(ParallelEnv):  # type: ignore[misc]  # PettingZoo is untyped
    """What environments share whose agents, by name, take meta-actions."""

    possible_agents: list[str]
    agents: list[str]
    """Those that drive."""
    observation_spaces: dict[str, Any]
    action_spaces: dict[str, Any]
    _place: dict[str, int]
    """The place of each agent among `possible_agents`."""
    _has_started = False

    def observation_space(self, agent: str) -> Any:
        """The space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """The space of an agent's actions, indices into the names of the meta-actions."""
        return self.action_spaces[agent]

    def _checked(self, actions: Mapping[str, int], names: Sequence[str], idle: int) -> Ints:
        """The actions (L,); those of agents that have left are `idle`.

        Raises:
            ResetNeeded: There was no reset yet.
            InputError: An action has none of the `names`, or the actions are not those of `agents`.
        """
        if not self._has_started:
            raise ResetNeeded("step before the first reset")
        if actions.keys() != {*self.agents}:
            missing = ", ".join(agent for agent in self.agents if agent not in actions)
            other = ", ".join(str(agent) for agent in actions if agent not in self.agents)
            raise InputError(
                "step takes one action for each agent in `agents`; "
                f"missing: {missing or 'none'}; unexpected: {other or 'none'}"
            )
        chosen = np.full(len(self.possible_agents), idle)
        for agent, action in actions.items():
            try:
                found = index(action)
            except TypeError:
                found = -1
            if not 0 <= found < len(names):
                expected = f"expected 0 to {len(names) - 1}: {', '.join(names)}"
                raise InputError(f"{agent}: no action {action}; {expected}")
            chosen[self._place[agent]] = found
        return chosen


class HighwayParallelEnv(NamedAgents):
    """One episode after another, in which the caller drives all vehicles or some of them.

    The agents are `vehicle_0`, the ego, and `vehicle_k`, the k-th of the other vehicles in the
    order of spawning. An agent terminates, and leaves `agents`, when its vehicle crashes or leaves
    the road. Its vehicle stays in the scene, which goes on for the other agents. When the time is
    over, the remaining agents are truncated.

    `reset(seed=k)` starts the episode of a suite with seed k. Without a seed, one is drawn that no
    suite evaluates on.

    The arguments are those of `LearnersVectorEnv`, without the number of scenes.

    Raises:
        InputError: The traffic is not installed, or an argument is wrong.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # pettingzoo's declaration
        "name": "charms_bench_many_learners_v0",
        "render_modes": RENDER_MODES,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        learners: Iterable[int] | None = None,
        traffic: TrafficLike | None = None,
        reward: VehicleReward = highway_rewards,
        observation: ObservationLike = "neighbours",
        render_mode: str | None = None,
        longitudinal: bool = True,
        lateral: bool = True,
        actions: MetaLike = "meta",
        **scene: Any,
    ) -> None:
        title = type(self).__name__
        settings, around, agents = surroundings(traffic, scene, title)
        seen = observation_of(observation)
        how = (around, agents, reward, seen, render_mode, title)
        self._learners = Learners(settings, 1, learners, *how, actions, longitudinal, lateral)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": settings.decision_hz}
        self.possible_agents = [f"vehicle_{number}" for number in self._learners.numbers]
        self.agents = []
        self._place = {agent: k for k, agent in enumerate(self.possible_agents)}
        # Each agent has spaces of its own, because a space holds the seed of its samples.
        spaces = {agent: deepcopy(self._learners.spaces) for agent in self._place}
        self.observation_spaces = {agent: seen for agent, (seen, _) in spaces.items()}
        self.action_spaces = {agent: chosen for agent, (_, chosen) in spaces.items()}
        self._rng = np.random.default_rng()

    @property
    def simulation(self) -> Simulation:
        """The simulation of the episode."""
        return self._learners.simulation

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observations], dict[str, dict[str, Any]]]:
        """Starts an episode; every agent's info contains its `seed` and its `action_mask`.

        Args:
            seed: The episode's seed; None draws one.
            options: Ignored, which PettingZoo's tests require.

        Raises:
            InputError: The seed is out of range.
        """
        if seed is None:
            seed = EVALUATION_SEEDS + int(self._rng.integers(2**62))
        else:
            seed = checked_seed(seed)
            self._rng = np.random.default_rng(seed)
        self._learners.reset(np.array([seed], dtype=np.uint64), np.zeros(1, dtype=np.int64))
        alive = self._learners.alive
        self.agents = [agent for agent, place in self._place.items() if alive[place]]
        self._has_started = True
        self._learners.show()
        return self._observe(), {
            agent: {"seed": seed, **info} for agent, info in self._masks().items()
        }

    def step(self, actions: Mapping[str, int]) -> Step:
        """Carries out the actions of all agents for one decision interval.

        Returns:
            Observations, rewards, terminations, truncations and infos of the agents that acted. An
            info contains the agent's `action_mask` (A,); see `world.action_mask`. The last info of
            an agent contains its `ending`, one of `engine.simulation.ENDINGS`.

        Raises:
            InputError: An action is wrong, or those of `actions` are not the agents in `agents`.
            ResetNeeded: There was no reset yet.
        """
        if self._has_started and not self.agents:
            return {}, {}, {}, {}, {}
        names = self._learners.actions.names
        outcome = self._learners.step(self._checked(actions, names, 0))  # which nobody obeys
        acted, observations, infos = self.agents, self._observe(), self._masks()
        rewards, terminated, truncated, endings = (
            {agent: values[self._place[agent]] for agent in acted}
            for values in (part.tolist() for part in outcome)
        )
        for agent in acted:
            if endings[agent] != RUNNING:
                infos[agent]["ending"] = ENDINGS[endings[agent]]
        self.agents = [agent for agent in acted if endings[agent] == RUNNING]
        return observations, rewards, terminated, truncated, infos

    def render(self) -> NDArray[np.uint8] | None:
        """The scene around `vehicle_0`, (height, width, 3); see `HighwayVectorEnv.render`."""
        frames = self._learners.render()
        return frames[0] if frames else None

    def close(self) -> None:
        """Closes the window."""
        self._learners.renderer.close()

    def _observe(self) -> dict[str, Observations]:
        """The observations of `agents`."""
        seen = self._learners.observe(self._vehicles())
        return dict(zip(self.agents, seen, strict=True))

    def _masks(self) -> dict[str, dict[str, Any]]:
        """The infos of `agents` with their action masks."""
        masks = zip(self.agents, self._learners.masks(self._vehicles()), strict=True)
        return {agent: {"action_mask": mask} for agent, mask in masks}

    def _vehicles(self) -> Vehicles:
        """The vehicles of `agents`."""
        places = self._learners.places[[self._place[agent] for agent in self.agents]]
        return np.zeros_like(places), places
