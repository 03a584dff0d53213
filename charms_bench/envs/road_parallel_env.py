"""highway-env's environments with several agents as a PettingZoo `ParallelEnv`.

It needs the extra `pettingzoo`.
"""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from charms_bench.envs.parallel_env import NamedAgents, Step
from charms_bench.envs.rendering import RENDER_MODES, Frame, Renderer
from charms_bench.envs.road_env import RoadScenes, episodes_of, spaces_of
from charms_bench.envs.road_rendering import RoadPictures
from charms_bench.envs.seeds import checked_seed, random_seeds
from charms_bench.errors import InputError
from charms_bench.world.scene import Observations

Infos = dict[str, dict[str, Any]]


class RoadParallelEnv(RoadScenes, NamedAgents):
    """One episode after another of one of highway-env's environments with several agents.

    The agents are `vehicle_0`, `vehicle_1` and so on, in the order of highway-env's
    `controlled_vehicles`. An agent terminates, and leaves `agents`, when its vehicle crashes or
    arrives. Its vehicle stays in the scene and is given no more actions but `IDLE`. When the time
    is over, the remaining agents are truncated.

    The same seed gives the scene of highway-env, and the same actions the same episode.

    Args:
        name: highway-env's name of the environment, such as `intersection-multi-agent-v1`.
        config: highway-env's configuration; what is not given has its default.
        render_mode: `rgb_array`, `human`, or None.

    Raises:
        InputError: The environment has one agent or actions that are not meta-actions, its
            configuration is not supported, or there is no such mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # pettingzoo's declaration
        "name": "charms_bench_road_v0",
        "render_modes": RENDER_MODES,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        name: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._name, self._episodes = name, episodes_of(name, 1, config)
        if not (self._episodes.has_agents and self._episodes.sees_agents):
            raise InputError(
                f"{name}: expected actions of type 'MultiAgentAction' and observations of type "
                "'MultiAgentObservation'"
            )
        if not self._episodes.task.rewards_each:
            raise InputError(f"{name}: highway-env has rewards of the first of several egos only")
        if "IDLE" not in getattr(self._episodes.actions, "names", ()):
            raise InputError(f"{name}: expected actions of type 'DiscreteMetaAction'")
        self._episodes.seed(self._episodes.everyone, random_seeds(1))
        hz = self._episodes.config["policy_frequency"]
        self.render_mode, self._pictures = render_mode, RoadPictures()
        self._renderer = Renderer(1, hz, render_mode, name)
        self.metadata = {**self.metadata, "render_fps": hz}
        self.possible_agents = [f"vehicle_{k}" for k in range(self._episodes.agents)]
        self.agents = []
        self._place = {agent: k for k, agent in enumerate(self.possible_agents)}
        seen: Any
        chosen: Any
        seen, chosen = spaces_of(self._episodes)
        # Each agent has spaces of its own, because a space holds the seed of its samples.
        self.observation_spaces = dict(zip(self._place, deepcopy([*seen]), strict=True))
        self.action_spaces = {agent: deepcopy(chosen[k]) for agent, k in self._place.items()}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observations], Infos]:
        """Starts an episode.

        Args:
            seed: That of the random generator; None continues it.
            options: Ignored, which PettingZoo's tests require.

        Returns:
            Observations, and infos with each vehicle's `speed` and whether it has `crashed`.

        Raises:
            InputError: The seed is out of range.
        """
        episodes = self._episodes
        if seed is not None:
            seeds = np.array([checked_seed(seed)], dtype=np.uint64)
            episodes.seed(episodes.everyone, seeds)
        episodes.start(episodes.everyone)
        self.agents, self._has_started = self.possible_agents.copy(), True
        self._seen = episodes.observe()
        self._renderer.show(self._frame)
        return self._of_agents(self._seen), self._infos()

    def step(self, actions: Mapping[str, int]) -> Step:
        """Carries out the actions of all agents until the next decision.

        Returns:
            Observations, rewards, terminations, truncations and infos of the agents that acted.

        Raises:
            InputError: An action is wrong, or those of `actions` are not the agents in `agents`.
            ResetNeeded: There was no reset yet.
        """
        if self._has_started and not self.agents:
            return {}, {}, {}, {}, {}
        episodes = self._episodes
        names: Any = episodes.actions
        chosen = self._checked(actions, names.names, names.names.index("IDLE"))
        decision = episodes.step(tuple(chosen[:, None]))
        self._seen = decision.observations
        self._renderer.show(self._frame)
        found = episodes.task.information(episodes.scenes)
        observations, infos = self._of_agents(decision.observations), self._infos()
        rewards = self._of_agents(found["agents_rewards"].T)
        terminated = self._of_agents(found["agents_terminated"].T)
        truncated = dict.fromkeys(self.agents, bool(decision.truncated[0]))
        self.agents = [
            agent for agent in self.agents if not (terminated[agent] or truncated[agent])
        ]
        return (
            observations,
            {agent: float(reward) for agent, reward in rewards.items()},
            {agent: bool(is_over) for agent, is_over in terminated.items()},
            truncated,
            infos,
        )

    def render(self) -> Frame | None:
        """The picture (height, width, 3) in the mode `rgb_array`; None in other modes."""
        self._check_started("render")
        frames = self._renderer.render(self._frame)
        return frames[0] if frames else None

    def close(self) -> None:
        """Closes the window."""
        self._renderer.close()

    def _of_agents(self, values: Any) -> dict[str, Any]:
        """The values of `agents`, from those (1, ...) of all agents."""
        return {agent: values[self._place[agent]][0] for agent in self.agents}

    def _infos(self) -> Infos:
        """The infos of `agents`."""
        vehicles = self._episodes.scenes.vehicles[0]
        return {
            agent: {
                "speed": float(vehicles["speed"][self._place[agent]]),
                "crashed": bool(vehicles["crashed"][self._place[agent]]),
            }
            for agent in self.agents
        }
