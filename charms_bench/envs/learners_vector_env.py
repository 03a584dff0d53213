"""Many learners as arrays: the caller drives L vehicles in each of B scenes."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from charms_bench.envs.ego_env import TrafficLike, surroundings
from charms_bench.envs.given_actions import MetaLike
from charms_bench.envs.highway_reward import highway_rewards
from charms_bench.envs.learners import Learners, VehicleReward
from charms_bench.envs.scene_episodes import OfScenes, SceneEpisodes
from charms_bench.envs.vector_env import ScenesVectorEnv
from charms_bench.world.observations import ObservationLike, observation_of
from charms_bench.world.scene import Bools


class LearnersVectorEnv(OfScenes, ScenesVectorEnv):
    """B scenes with L learners each, as a Gymnasium vector environment; see `ScenesVectorEnv`.

    `array.reshape(B, L, ...)` has one row per scene. A learner's episode terminates when its
    vehicle crashes or leaves the road, and is truncated when the scene's time is over. Its vehicle
    stays in the scene, which goes on for the other learners. `alive` is false for learners that
    have left; they wait there for the next episode.

    Args:
        scenes: B.
        learners: The L vehicles that the caller drives. Vehicle 0, the ego, must be one of them;
            vehicle k is the k-th of the others in the order of spawning. None means all vehicles.
        traffic: Assigns a driver to each of the other vehicles; see `EgoEnv`.
        reward: The rewards (M,) of M vehicles after a decision; by default highway-env's.
        observation: The learners' observation; see `charms_bench.world.observations`.
        actions: The learners' meta-actions; see `EgoEnv`.
        render_mode: `rgb_array` or `human`; see `render`.
        longitudinal: Whether actions change the speed.
        lateral: Whether actions change the lane.
        autoreset_mode: When the next scene starts; see `ScenesVectorEnv`.
        first_seed: That of the first scene, from which those of the next ones count on.
        scene: `density`, `lanes`, `traffic_vehicles`, `profile` and all other keys of a suite's
            `scene`, with the same defaults.

    Raises:
        InputError: The traffic is not installed, or an argument is wrong.
    """

    def __init__(
        self,
        scenes: int,
        learners: Iterable[int] | None = None,
        traffic: TrafficLike | None = None,
        reward: VehicleReward = highway_rewards,
        observation: ObservationLike = "neighbours",
        render_mode: str | None = None,
        longitudinal: bool = True,
        lateral: bool = True,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        first_seed: int | None = None,
        actions: MetaLike = "meta",
        **scene: Any,
    ) -> None:
        title = type(self).__name__
        settings, around, agents = surroundings(traffic, scene, title)
        how = (around, agents, reward, observation_of(observation), title)
        made = Learners(settings, scenes, learners, *how, actions, longitudinal, lateral)
        super().__init__(SceneEpisodes(made), render_mode, first_seed, autoreset_mode)

    @property
    def learners(self) -> tuple[int, ...]:
        """The numbers of the L learners."""
        found: tuple[int, ...] = self._episodes.learners.numbers
        return found

    @property
    def alive(self) -> Bools:
        """(B L,) whether the learner drives, so that its next action counts."""
        return np.array(self._episodes.learners.alive)
