"""B episodes of one of highway-env's environments, which advance together."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.exact_maths import exact_roads
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.generator import seeded
from charms_bench.roads import TASKS, configuration
from charms_bench.roads.controls import actions_of
from charms_bench.roads.lanes import road_of
from charms_bench.roads.linear import constants_of, gains_of, linear_type
from charms_bench.roads.observing import Observed, observer_of
from charms_bench.roads.scenes import LANDMARK, OBSTACLE, Scenes, place
from charms_bench.roads.stepping import decide
from charms_bench.roads.task import Task
from charms_bench.world.profile import HIGHWAY_ENV

Seen = Observed | tuple[Observed, ...]
"""Observations (B, ...); of several agents, those of each."""


class Decision(NamedTuple):
    """What a decision led to, for each scene (B,)."""

    observations: Seen
    rewards: Floats
    terms: Floats
    """(B, K) the terms of the rewards."""
    terminated: Bools
    truncated: Bools


_PLAIN: dict[str, Any] = {
    "observation": {"type": "Kinematics"},
    "initial_vehicle_count": 0,
    "simulation_frequency": 15,
}
"""The configuration with which highway-env's road is read."""
_CHANGED = "DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN"


class Episodes:
    """B scenes of the environment with highway-env's name `name`, such as `merge-v0`.

    Raises:
        InputError: The configuration has an unknown key or a value that is not supported.
    """

    def __init__(self, name: str, count: int, config: Mapping[str, Any] | None = None) -> None:
        import highway_env  # noqa: F401  # registers its environments

        self.name = name
        spec = gymnasium.spec(name)
        source: Any = gymnasium.envs.registration.load_env_creator(str(spec.entry_point))
        with exact_roads(), unchanged_idm():
            stock = source()
        self.config = configuration.checked(stock.config, config)
        """highway-env's configuration, with the defaults."""
        self.is_split = bool(spec.additional_wrappers)
        """Whether each agent has its own reward and ending [`MultiAgentWrapper`]."""
        one, self.has_agents = configuration.of_each_agent(self.config, "action")
        """Whether an action is one for each agent."""
        one, self.sees_agents = configuration.of_each_agent(one, "observation")
        """Whether an observation is one of each agent."""
        module, class_name = TASKS[name].split(":")
        task: type[Task] = getattr(import_module(f"charms_bench.roads.{module}"), class_name)
        with configuration.named(".action"):
            self.actions = actions_of(one, task.actions)
        """Those of one agent."""
        stock.configure({**self.config, **_PLAIN, "action": {"type": task.actions[0]}})
        try:
            with exact_roads(), unchanged_idm():
                stock.reset()
        except Exception as error:  # whatever a value leads to in highway-env
            raise InputError(f"config: highway-env does not start with it: {error!r}") from error
        road = road_of(stock.road.network)
        with configuration.named(""):
            self.task = task(one, stock.road.network)
        self.agents = self.task.egos if self.has_agents else 1
        """The number of egos that are given actions."""
        with configuration.named(".observation"):
            self.observers = [
                observer_of(one, count, self.task.lanes, ego)
                for ego in range(self.task.egos if self.sees_agents else 1)
            ]
        hz = self.config["simulation_frequency"]
        constants = HIGHWAY_ENV.constants(1 / hz)
        linear = linear_type(self.config) if self.task.takes_types else None
        own = constants_of(linear) if linear else {}
        idm = constants.idm_mobil._replace(**self.task.idm, **own)
        self._frames = int(hz // self.config["policy_frequency"])
        self._interval = 1 / self.config["policy_frequency"]
        self._most_steps = spec.max_episode_steps
        self.steps = np.zeros(count, dtype=np.int64)
        """(B,) the decisions of each episode so far."""
        self.scenes = Scenes.empty(
            count,
            self.task.vehicles + len(stock.road.objects),
            road,
            self.config["neighbour_vehicles_connected_lanes"],
            self.actions.target_speeds,
            constants._replace(idm_mobil=idm),
            self.task.regulation_steps,
            gains_of(linear) if linear else None,
        )
        for b in range(count):
            for k, each in enumerate(stock.road.objects):
                where = (*map(float, each.position), float(each.heading), float(each.speed))
                kind = LANDMARK if type(each).__name__ == "Landmark" else OBSTACLE
                place(self.scenes, b, self.task.vehicles + k, kind, *where)
                row = self.scenes.vehicles[b, self.task.vehicles + k]
                row["length"], row["width"] = each.LENGTH, each.WIDTH
        self.everyone = np.arange(count)
        self._rewards = np.zeros((count, 1 + len(self.task.terms)))

    def seed(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        """Seeds the random generators of the scenes `rows`; otherwise, they continue."""
        self.scenes.generator[rows] = seeded(seeds)

    def start(self, rows: Ints) -> None:
        """Starts an episode in each of the scenes `rows`."""
        scenes = self.scenes
        scenes.time[rows] = 0.0
        self.steps[rows] = 0
        scenes.vehicles["crashed"][rows, self.task.vehicles :] = False  # obstacles, too, are new
        self.task.start(scenes, rows)
        for observer in self.observers:
            observer.start(scenes, rows)

    def step(self, actions: NDArray[Any] | tuple[NDArray[Any], ...]) -> Decision:
        """Carries out the egos' actions (B, ...), each one of `actions.space`.

        Those of several agents are a tuple.
        """
        scenes, rewards = self.scenes, self._rewards
        self.task.prepare(scenes, self.everyone)
        parts = actions if isinstance(actions, tuple) else (actions,)
        given = [self.actions.give(scenes, part, ego) for ego, part in enumerate(parts)]
        seen = self.observe() if self.task.observes_before else None
        decide(scenes, self.everyone, np.stack(given, axis=1), self._frames, self._interval)
        self.steps += 1
        self.task.judge(scenes, self.everyone, parts[0], rewards)
        truncated = self.task.is_truncated(scenes)
        if self._most_steps is not None:
            truncated = truncated | (self.steps >= self._most_steps)
        found, terminated = rewards.copy(), self.task.is_terminated(scenes)
        seen = self.observe() if seen is None else seen
        self.task.follow(scenes, self.everyone)
        return Decision(seen, found[:, 0], found[:, 1:], terminated, truncated)

    def observe(self, rows: Ints | None = None) -> Seen:
        """The observations of the scenes `rows`; by default, of all scenes.

        To be called once after `start`, for the scenes that were started: some observations have
        noise. Those after a decision are part of it.
        """
        rows = self.everyone if rows is None else rows
        seen = [observer.observe(self.scenes, rows) for observer in self.observers]
        return tuple(seen) if self.sees_agents else seen[0]


@contextmanager
def unchanged_idm() -> Iterator[None]:
    """Restores the constants that highway-env's `intersection` changes for the whole process."""
    module: Any = import_module("highway_env.vehicle.behavior")
    kinds = [getattr(module, name) for name in configuration.TYPES]
    before = [{name: vars(kind)[name] for name in _CHANGED if name in vars(kind)} for kind in kinds]
    try:
        yield
    finally:
        for kind, values in zip(kinds, before, strict=True):
            for name in _CHANGED:
                if name in values:
                    setattr(kind, name, values[name])
                elif name in vars(kind):
                    delattr(kind, name)
