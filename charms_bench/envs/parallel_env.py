"""Many learners as a PettingZoo `ParallelEnv`; it needs the extra `pettingzoo`."""

from collections.abc import Iterable, Mapping
from copy import deepcopy
from operator import index
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.envs.ego_env import TrafficLike, surroundings
from charms_bench.envs.episodes import FIRST_SCENE, Episodes
from charms_bench.envs.given_actions import MetaLike
from charms_bench.envs.highway_reward import highway_rewards
from charms_bench.envs.learners import Learners, VehicleReward
from charms_bench.envs.rendering import RENDER_MODES, Renderer
from charms_bench.envs.scene_episodes import OfScenes, SceneEpisodes
from charms_bench.envs.seeds import checked_seed
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Ints
from charms_bench.world.observations import ObservationLike, observation_of

try:
    from pettingzoo import ParallelEnv as ParallelEnv
except ImportError as error:
    needed = f"a ParallelEnv needs PettingZoo ({error}); pip install 'charms-bench[pettingzoo]'"
    raise ImportError(needed, name="pettingzoo") from error

OfAgents = dict[str, Any]
"""Something of each agent, by its name."""
Step = tuple[OfAgents, dict[str, float], dict[str, bool], dict[str, bool], OfAgents]


class AgentsState(NamedTuple):
    """The state of an episode, and the agents that drive."""

    episodes: Any
    agents: tuple[str, ...]


class AgentsParallelEnv(ParallelEnv):  # type: ignore[misc]  # PettingZoo is untyped
    """One episode after another, in which the caller drives agents with meta-actions.

    The agents are called `vehicle_k`, and `vehicle_0` is the ego. An agent terminates, and leaves
    `agents`, when its vehicle crashes, arrives or leaves the road. Its vehicle stays in the scene,
    which goes on for the other agents. When the time is over, the remaining agents are truncated.

    Args:
        episodes: The episodes of the agents.
        render_mode: `rgb_array`, `human`, or None.

    Raises:
        InputError: There is no such mode.
    """

    metadata: dict[str, Any]
    possible_agents: list[str]
    agents: list[str]
    """The agents that still drive."""

    def __init__(self, episodes: Episodes, render_mode: str | None) -> None:
        self._episodes: Any = episodes
        self.render_mode = render_mode
        self._renderer = Renderer(1, episodes.decision_hz, render_mode, episodes.title)
        self.metadata = {**self.metadata, "render_fps": episodes.decision_hz}
        self.possible_agents = [f"vehicle_{number}" for number in episodes.numbers]
        self.agents = []
        self._place = {agent: k for k, agent in enumerate(self.possible_agents)}
        # Each agent has spaces of its own, because a space holds the seed of its samples.
        spaces = [deepcopy(each) for each in episodes.spaces_of_agents()]
        both = dict(zip(self.possible_agents, spaces, strict=True))
        self.observation_spaces = {agent: seen for agent, (seen, _) in both.items()}
        self.action_spaces = {agent: chosen for agent, (_, chosen) in both.items()}

    def observation_space(self, agent: str) -> Any:
        """The space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """The space of an agent's actions, indices into the names of the meta-actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[OfAgents, OfAgents]:
        """Starts an episode; every agent's info contains its `action_mask`.

        Args:
            seed: The episode's seed; None continues the random generator.
            options: Ignored, which PettingZoo's tests require.

        Raises:
            InputError: The seed is out of range.
        """
        episodes, seeds = self._episodes, [None if seed is None else checked_seed(seed)]
        episodes.reseed(FIRST_SCENE, seeds)
        episodes.start(FIRST_SCENE, seeds)
        drives = episodes.driving()
        self.agents = [agent for agent, place in self._place.items() if drives[place]]
        self._renderer.show(episodes.frame)
        return self._observed(starts=True)

    def step(self, actions: Mapping[str, int]) -> Step:
        """Carries out the actions of all agents until the next decision.

        Returns:
            Observations, rewards, terminations, truncations and infos of the agents that acted. An
            info contains the agent's `action_mask` (A,); see `world.action_mask`.

        Raises:
            InputError: An action is wrong, or those of `actions` are not the agents in `agents`.
            ResetNeeded: There was no reset yet.
        """
        episodes = self._episodes
        episodes.check_started("step")
        if not self.agents:
            return {}, {}, {}, {}, {}
        outcome = episodes.decide_each(self._checked(actions))
        self._renderer.show(episodes.frame)
        rewards: Any
        terminated: Any
        truncated: Any
        rewards, terminated, truncated = (
            {agent: part[self._place[agent]] for agent in self.agents} for part in outcome
        )
        observations, infos = self._observed()
        self.agents = [each for each in self.agents if not (terminated[each] or truncated[each])]
        return observations, rewards, terminated, truncated, infos

    def _observed(self, *, starts: bool = False) -> tuple[OfAgents, OfAgents]:
        """The observations and the infos of `agents`."""
        which = np.array([self._place[agent] for agent in self.agents], dtype=np.int64)
        seen, infos = self._episodes.seen_by(which), self._episodes.infos_of(which, starts=starts)
        return dict(zip(self.agents, seen, strict=True)), dict(zip(self.agents, infos, strict=True))

    def _checked(self, actions: Mapping[str, int]) -> Ints:
        """The actions (L,).

        Raises:
            InputError: An action is none, or the actions are not those of `agents`.
        """
        names = self._episodes.action_names
        if actions.keys() != {*self.agents}:
            missing = ", ".join(agent for agent in self.agents if agent not in actions)
            other = ", ".join(str(agent) for agent in actions if agent not in self.agents)
            raise InputError(
                "step takes one action for each agent in `agents`; "
                f"missing: {missing or 'none'}; unexpected: {other or 'none'}"
            )
        chosen = np.full(len(self.possible_agents), self._episodes.idle)
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

    def render(self) -> NDArray[np.uint8] | None:
        """The scene around `vehicle_0`, (height, width, 3); see `SingleEnv.render`."""
        self._episodes.check_started("render")
        frames = self._renderer.render(self._episodes.frame)
        return frames[0] if frames else None

    def close(self) -> None:
        """Closes the window."""
        self._renderer.close()

    def get_state(self) -> AgentsState:
        """The state of the episode, for `set_state`."""
        return AgentsState(self._episodes.saved(None), (*self.agents,))

    def set_state(self, state: AgentsState) -> OfAgents:
        """Continues the episode of a state; returns the last observations of its agents.

        Raises:
            InputError: The state does not fit.
        """
        if not isinstance(state, AgentsState):
            raise InputError(f"set_state: found {type(state).__name__}, expected an AgentsState")
        self._episodes.load(state.episodes)
        self.agents = [*state.agents]
        return self._observed()[0]


class HighwayParallelEnv(OfScenes, AgentsParallelEnv):
    """An `AgentsParallelEnv` in which the caller drives all vehicles or some of them.

    `vehicle_k` is the k-th of the other vehicles in the order of spawning. `reset(seed=k)` starts
    the episode of a suite with seed k. Without a seed, one is drawn that no suite evaluates on. The
    first infos contain the `seed`, and the last info of an agent contains its `ending`, one of
    `engine.simulation.ENDINGS`.

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
        how = (around, agents, reward, observation_of(observation), title)
        made = Learners(settings, 1, learners, *how, actions, longitudinal, lateral)
        super().__init__(SceneEpisodes(made), render_mode)
