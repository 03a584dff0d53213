"""highway-env's other environments, such as `charms_bench/merge-v0`, alone and as vectors."""

from collections.abc import Mapping
from copy import deepcopy
from itertools import product
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from charms_bench.envs.base_env import SingleEnv
from charms_bench.envs.episodes import checked_options
from charms_bench.envs.road_episodes import RoadEpisodes, RoadReward
from charms_bench.envs.road_state import RoadState, RoadVehicle, missing
from charms_bench.envs.vector_env import ScenesVectorEnv
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Floats
from charms_bench.roads.configuration import plain


class RoadEnv(SingleEnv):
    """One episode after another of one of highway-env's environments.

    The same seed gives the scene of highway-env, and the same actions the same episode. Where
    highway-env has several agents, observations are tuples of theirs; in `intersection-multi-agent`
    from `-v1` on, so are rewards and terminations. Infos are highway-env's.

    Args:
        name: highway-env's name of the environment, such as `merge-v0`.
        config: highway-env's configuration; what is not given has its default.
        render_mode: `rgb_array`, `human`, or None.
        reward: The reward of a decision, see `RoadReward`; by default that of highway-env.

    Raises:
        InputError: The configuration has an unknown key or a value that is not supported, there is
            no such mode, or the reward is not a function.
    """

    def __init__(
        self,
        name: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        reward: RoadReward | None = None,
    ) -> None:
        super().__init__(RoadEpisodes(name, 1, config, reward), render_mode)
        self.config = deepcopy(self._episodes.inner.config)
        """highway-env's configuration, with the defaults; changes count from the next reset on."""

    def __getattr__(self, name: str) -> Any:
        """Says what to use instead of what highway-env has and this environment has not."""
        raise missing(self, name)

    @property
    def action_type(self) -> Any:
        """The actions; of meta-actions, it has `actions` and `actions_indexes`."""
        return self._episodes.inner.actions

    @property
    def time(self) -> float:
        """Since the start of the episode, s."""
        return float(self._episodes.inner.scenes.time[0])

    @property
    def road(self) -> RoadState:
        """The vehicles on the road as they are now, which cannot be changed.

        After a step, ask again.
        """
        return RoadState([*self._episodes.vehicles().values()])

    @property
    def controlled_vehicles(self) -> list[RoadVehicle]:
        """The egos among `road.vehicles`."""
        vehicles = self._episodes.vehicles()
        return [vehicles[ego] for ego in range(self._episodes.inner.task.egos)]

    @property
    def vehicle(self) -> RoadVehicle:
        """The first ego."""
        return self.controlled_vehicles[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: That of the random generator; None continues it.
            options: `config`, values that change the configuration from now on, or `state`.

        Returns:
            The observation, and an info with the ego's `speed` and whether it has `crashed`.

        Raises:
            InputError: There is another option, or a value is not supported.
        """
        options = checked_options(options, "config", "state")
        config = options.pop("config", None) or {}
        if not isinstance(config, Mapping):
            raise InputError(f"reset: option 'config': {config!r}; expected a dictionary")
        changed = plain({**self.config, **config})
        episodes = self._episodes
        if changed != episodes.inner.config:
            before = episodes.inner.scenes.generator
            episodes.configure(deepcopy(changed))
            episodes.inner.scenes.generator[:] = before
            self.observation_space, self.action_space = episodes.spaces
        self.config = changed
        return super().reset(seed=seed, options=options)

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Changes the configuration from the next reset on [`AbstractEnv.configure`]."""
        self.config |= deepcopy(dict(config or {}))

    def set_record_video_wrapper(self, wrapper: Any) -> None:
        """Does nothing, since each decision has one picture [`set_record_video_wrapper`]."""

    def get_available_actions(self) -> Any:
        """The actions that have an effect now [`DiscreteMetaAction.get_available_actions`].

        With several agents, these are the combinations of theirs.
        """
        names, masks = self._episodes.meta_actions.names, self._episodes.masks()[0]
        possible = [names.index(each) for each in _AS_IN_HIGHWAY_ENV if each in names]
        each = [[k for k in possible if mask[k]] for mask in np.atleast_2d(masks)]
        return product(*each) if self._episodes.inner.has_agents else each[0]


class GoalRoadEnv(RoadEnv):
    """A `RoadEnv` whose observations have goals."""

    def compute_reward(
        self, achieved_goal: Floats, desired_goal: Floats, info: Any = None, p: float = 0.5
    ) -> Any:
        """The rewards (...) of goals (..., F), as Hindsight Experience Replay needs them.

        Args:
            achieved_goal: What was reached.
            desired_goal: What should have been reached.
            info: Not used.
            p: The exponent of the distance.
        """
        return self._episodes.goal_rewards(achieved_goal, desired_goal, p)


class RoadVectorEnv(ScenesVectorEnv):
    """B environments `RoadEnv` side by side; where an episode ends, the next starts at once.

    With several agents, observations and actions are tuples of theirs. Rewards are the means over
    the agents, an episode ends where highway-env's does without `MultiAgentWrapper`, and infos have
    `agents_rewards` and `agents_terminated` (B, A).

    Args:
        num_envs: B.
        name: highway-env's name of the environment, such as `merge-v0`.
        config: highway-env's configuration; what is not given has its default.
        render_mode: `rgb_array`, `human`, or None.
        autoreset_mode: When the next episode starts; see `ScenesVectorEnv`.
        reward: The rewards of a decision, see `RoadReward`; by default those of highway-env.
        first_seed: That of the first episode, from which those of the next ones count on.
    """

    def __init__(
        self,
        num_envs: int,
        name: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        reward: RoadReward | None = None,
        first_seed: int | None = None,
    ) -> None:
        episodes = RoadEpisodes(name, num_envs, config, reward)
        super().__init__(episodes, render_mode, first_seed, autoreset_mode)

    @property
    def config(self) -> dict[str, Any]:
        """highway-env's configuration, with the defaults."""
        found: dict[str, Any] = self._episodes.inner.config
        return found

    def compute_reward(
        self, achieved_goal: Floats, desired_goal: Floats, info: Any = None, p: float = 0.5
    ) -> Any:
        """The rewards of goals; see `GoalRoadEnv.compute_reward`."""
        return self._episodes.goal_rewards(achieved_goal, desired_goal, p)


_AS_IN_HIGHWAY_ENV = ("IDLE", "LANE_LEFT", "LANE_RIGHT", "FASTER", "SLOWER")
"""The order of [`DiscreteMetaAction.get_available_actions`]."""
