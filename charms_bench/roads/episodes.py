"""B episodes of one of highway-env's environments, which advance together."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.exact_maths import exact_roads
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.generator import seeded
from charms_bench.roads import TASKS, configuration
from charms_bench.roads.lanes import road_of
from charms_bench.roads.observing import observer_of
from charms_bench.roads.scenes import OBSTACLE, Scenes, place
from charms_bench.roads.stepping import decide
from charms_bench.roads.task import Task
from charms_bench.world.profile import HIGHWAY_ENV
from charms_bench.world.scene import Observations


class Decision(NamedTuple):
    """What a decision led to, for each scene (B,)."""

    rewards: Floats
    terms: Floats
    """(B, K) the terms of the rewards."""
    terminated: Bools
    truncated: Bools


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
        self.config = configuration.checked(source.default_config(), config)
        """highway-env's configuration, with the defaults."""
        plain = {"observation": {"type": "Kinematics"}, "action": {"type": "DiscreteMetaAction"}}
        with exact_roads():
            stock = source(config={**self.config, **plain})
        road = road_of(stock.road.network)
        module, kind = TASKS[name].split(":")
        kinds = import_module(f"charms_bench.roads.{module}")
        self.task: Task = getattr(kinds, kind)(self.config, stock.road.network)
        self.actions = configuration.meta_actions(self.config)
        self.observer = observer_of(self.config, count, self.task.lanes)
        hz = self.config["simulation_frequency"]
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
            HIGHWAY_ENV.constants(1 / hz),
        )
        for b in range(count):
            for k, each in enumerate(stock.road.objects):
                where = (*map(float, each.position), float(each.heading), float(each.speed))
                place(self.scenes, b, self.task.vehicles + k, OBSTACLE, *where)
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
        self.task.start(scenes, rows)
        self.observer.start(scenes, rows)

    def step(self, actions: Ints) -> Decision:
        """Carries out the egos' actions (B,), which are indices into `actions.meaning`."""
        scenes, rewards = self.scenes, self._rewards
        meaning = self.actions.meaning[actions]
        decide(scenes, self.everyone, meaning, self._frames, self._interval)
        self.steps += 1
        self.task.judge(scenes, self.everyone, actions, rewards)
        truncated = self.task.is_truncated(scenes)
        if self._most_steps is not None:
            truncated = truncated | (self.steps >= self._most_steps)
        found = rewards.copy()
        return Decision(found[:, 0], found[:, 1:], self.task.is_terminated(scenes), truncated)

    def observe(self, rows: Ints | None = None) -> Observations:
        """The egos' observations of the scenes `rows`; by default, of all scenes."""
        return self.observer.observe(self.scenes, self.everyone if rows is None else rows)
