"""Egos that observe and act by a configuration of highway-env, as in its environments."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.meta_actions import index_of
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.plugins.agent import Policy
from charms_bench.roads.continuous_actions import Controls, actions_of, kind_of_ego
from charms_bench.roads.driving import command
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.locating import forget
from charms_bench.roads.observing import Kinematics, observer_of
from charms_bench.roads.scenes import Scenes, here_of
from charms_bench.world.actions import Actions
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.observations import observation_of


class ConfiguredEgos:
    """The egos of B episodes that a policy with the observation `highway_env` drives.

    In highway-env, an observation is older than the vehicles that leave and enter after the
    decision. So where vehicles do, the observations from before are kept.
    """

    def __init__(self, policy: Policy, episodes: Episodes) -> None:
        like = observation_of(policy.observation)
        assert isinstance(like, HighwayEnv)
        self.like, self._episodes = like, episodes
        if episodes.task.egos > 1:
            raise InputError("a policy with the observation highway_env is the only ego of a road")
        own = {"observation": like.observation, "action": like.action}
        config = episodes.config | own | {"policy_frequency": policy.decision_hz}
        count, lanes = episodes.everyone.size, episodes.task.lanes
        self._actions = actions_of(config, ("DiscreteMetaAction", "ContinuousAction"))
        self._observer = observer_of(config, count, lanes)
        self.kind = kind_of_ego(config)
        """An index into `scenes.KINDS`."""
        if self._observer.space.shape != like.shape:
            found = self._observer.space.shape
            raise InputError(f"observation highway_env: shape: {like.shape}; expected {found}")
        self._kept = np.zeros((count, *like.shape), dtype=np.float32)
        """The observations from before vehicles have left and entered."""
        self.keeps: Bools = np.zeros(count, dtype=np.bool_)
        """[B] whether they are those of the present moment."""
        self._scenes = episodes.scenes

    @property
    def scenes(self) -> Scenes:
        """The scenes with the target speeds of the configuration."""
        own, speeds = self._episodes.scenes, self._actions.target_speeds
        if self._scenes.generator is not own.generator or self._scenes.target_speeds is not speeds:
            self._scenes = own._replace(target_speeds=speeds)
        return self._scenes

    @property
    def _ranges(self) -> tuple[NDArray[Any], ...]:
        return (self._observer.ranges,) if isinstance(self._observer, Kinematics) else ()

    @property
    def state(self) -> tuple[NDArray[Any], ...]:
        """The arrays [B, ...] from which scenes continue."""
        return (*self._ranges, self._kept, self.keeps)

    def resume(self, rows: Ints) -> None:
        """Begins to observe the scenes `rows`."""
        self.keeps[rows] = False
        self._observer.start(self.scenes, rows)

    def start(self, rows: Ints) -> None:
        """Starts the episodes of the scenes `rows`."""
        self.resume(rows)
        if isinstance(self._actions, Controls):
            self._actions.take(self.scenes, rows, 1)
        else:
            _aim(self.scenes, rows)

    def keep(self, rows: Ints) -> None:
        """Keeps the observations of the scenes `rows`, in which vehicles may leave and enter."""
        self._kept[rows] = np.asarray(self._observer.observe(self.scenes, rows))
        self.keeps[rows] = True

    def observe(self, rows: Ints) -> NDArray[Any]:
        """The observations (R, ...) of the scenes `rows`."""
        fresh = rows[~self.keeps[rows]]
        if fresh.size:
            self._kept[fresh] = np.asarray(self._observer.observe(self.scenes, fresh))
        return self._kept[rows]

    def act(self, rows: Ints, actions: Actions) -> None:
        """Gives the egos of the scenes `rows` their actions (R,) or (R, 2)."""
        if isinstance(self._actions, Controls):
            actions = actions[:, self.like.controls]
        given = self._actions.give(self.scenes, rows, actions, 0)
        if not isinstance(self._actions, Controls):
            _command(self.scenes, rows, given)


@compiled_of_scenes
def _aim(scenes: Scenes, rows: Ints) -> None:
    """Gives the egos of new episodes the target speed nearest to their speed [`MDPVehicle`]."""
    for b in rows:
        ego, speeds = scenes.vehicles[b, 0], scenes.target_speeds
        ego.speed_index = index_of(ego.speed, speeds)
        ego.target_speed = speeds[ego.speed_index]


@compiled_of_scenes
def _command(scenes: Scenes, rows: Ints, actions: Ints) -> None:
    """Has the egos of the scenes `rows` carry out highway-env's meta-actions (R,)."""
    for r in range(rows.size):
        here = here_of(scenes, rows[r])
        for i in range(here.places):
            forget(here, i)
        command(scenes.road, scenes.target_speeds, here, 0, actions[r])


def configured(policies: Mapping[int, Policy], episodes: Episodes) -> dict[int, ConfiguredEgos]:
    """Those of the policies with the observation `highway_env`, by the index of the agent."""
    return {
        k: ConfiguredEgos(policy, episodes)
        for k, policy in policies.items()
        if isinstance(observation_of(policy.observation), HighwayEnv)
    }
