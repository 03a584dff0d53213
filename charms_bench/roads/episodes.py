"""B episodes of one of highway-env's environments, which advance together."""

import json
from collections.abc import Mapping
from copy import deepcopy
from functools import cached_property
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.generator import seeded
from charms_bench.roads import OF_FILES, TASKS, configuration
from charms_bench.roads.conflicts import Conflicts
from charms_bench.roads.continuous_actions import Controls, actions_of
from charms_bench.roads.defaults import DEFAULTS, MOST_STEPS, SPLIT
from charms_bench.roads.linear_vehicles import LINEAR, TIME_HEADWAY_S
from charms_bench.roads.observing import Kinematics, Observed, observer_of
from charms_bench.roads.scenes import LANDMARK, NOTHING, OBSTACLE, Scenes, place
from charms_bench.roads.stepping import decide
from charms_bench.roads.task import Task
from charms_bench.world.named_road import FILE_ROAD, NamedRoad
from charms_bench.world.plan_view import OF_VEHICLES, Lines, Plan
from charms_bench.world.profile import HIGHWAY_ENV

Seen = Observed | tuple[Observed, ...]
"""Observations (B, ...); of several agents, those of each."""


class EpisodesState(NamedTuple):
    """What B running episodes continue from."""

    environment: str
    """highway-env's name, and the configuration."""
    arrays: tuple[NDArray[Any], ...]
    """Those of `Episodes`."""
    seen: Seen
    """The last observations."""
    next_seed: int | None = None
    """Of a vector environment whose seeds count on."""


class Decision(NamedTuple):
    """What a decision led to, for each scene (B,)."""

    observations: Seen
    rewards: Floats
    terms: Floats
    """(B, K) the terms of the rewards."""
    terminated: Bools
    truncated: Bools


class Episodes:
    """B scenes of the environment with highway-env's name `name`, such as `merge-v0`.

    Those of a road in a file have the name `FILE_ROAD`. There is `room` for so many more vehicles.

    Raises:
        InputError: The configuration has an unknown key or a value that is not supported.
    """

    def __init__(
        self, name: str, count: int, config: Mapping[str, Any] | None = None, room: int = 0
    ) -> None:
        self.name = name
        task = _task_of(name)
        _check_egos(task, config)
        self.config = configuration.checked(DEFAULTS[name], config)
        """highway-env's configuration, with the defaults."""
        self.is_split = name in SPLIT
        """Whether each agent has its own reward and ending [`MultiAgentWrapper`]."""
        one, self.has_agents = configuration.of_each_agent(self.config, "action")
        """Whether an action is one for each agent."""
        one, self.sees_agents = configuration.of_each_agent(one, "observation")
        """Whether an observation is one of each agent."""
        with configuration.named(".action"):
            self.actions = actions_of(one, task.actions)
        """Those of one agent."""
        self.action_space = self.actions.space
        with configuration.named(""):
            self.task = task(one)
        self.agents = self.task.egos if self.has_agents else 1
        """The number of egos that are given actions."""
        with configuration.named(".observation"):
            self.observers = [
                observer_of(one, count, self.task.lanes, ego)
                for ego in range(self.task.egos if self.sees_agents else 1)
            ]
        hz = self.config["simulation_frequency"]
        constants = HIGHWAY_ENV.constants(1 / hz)
        kind = self.config["other_vehicles_type"].rpartition(".")[2]
        linear = LINEAR.get(kind) if self.task.takes_types else None
        idm = constants.idm_mobil._replace(**self.task.idm)
        if linear:
            gain = linear.lane_change_gain_mps2
            idm = idm._replace(time_headway_s=TIME_HEADWAY_S, lane_change_gain_mps2=gain)
        self._frames = int(hz // self.config["policy_frequency"])
        self._interval = 1 / self.config["policy_frequency"]
        self._most_steps = MOST_STEPS.get(name)
        self.steps = np.zeros(count, dtype=np.int64)
        """(B,) the decisions of each episode so far."""
        self._room = slice(self.task.vehicles, self.task.vehicles + room)
        """The places that are empty at the start."""
        self.scenes = Scenes.empty(
            count,
            self.task.vehicles + len(self.task.objects) + room,
            self.task.layout.network,
            self.config["neighbour_vehicles_connected_lanes"],
            self.actions.target_speeds,
            constants._replace(idm_mobil=idm),
            self.task.regulation_steps,
            linear.gains if linear else None,
            self.task.links,
        )
        for b in range(count):
            for i, each in enumerate(self.task.objects, self._room.stop):
                place(self.scenes, b, i, each.kind, each.x, each.y, each.heading, 0.0)
                row = self.scenes.vehicles[b, i]
                row["length"], row["width"] = each.length, each.width
        self.everyone = np.arange(count)
        self._rewards = np.zeros((count, 1 + len(self.task.terms)))

    @cached_property
    def conflicts(self) -> Conflicts:
        """Where the lanes cross and merge."""
        from charms_bench.roads.conflicts import conflicts  # slow to import

        return conflicts(self.scenes.road, self.task.ranks(self.scenes))

    def seed(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        """Seeds the random generators of the scenes `rows`; otherwise, they continue."""
        self.scenes.generator[rows] = seeded(seeds)

    def start(self, rows: Ints) -> None:
        """Starts an episode in each of the scenes `rows`."""
        scenes = self.scenes
        scenes.time[rows] = 0.0
        self.steps[rows] = 0
        scenes.vehicles["crashed"][rows, self.task.vehicles :] = False  # obstacles, too, are new
        scenes.vehicles["kind"][rows, self._room] = NOTHING
        scenes.order["place"][rows] = np.arange(scenes.order.shape[1])
        self.task.start(scenes, rows)
        if isinstance(self.actions, Controls):
            self.actions.take(scenes, rows, self.task.egos)
        for observer in self.observers:
            observer.start(scenes, rows)

    def state(self, seen: Seen) -> EpisodesState:
        """The present state, with the last observations, of which some have drawn noise."""
        arrays = tuple(array.copy() for array in self._kept)
        return EpisodesState(self._identity, arrays, deepcopy(seen))

    def restore(self, state: EpisodesState) -> Seen:
        """Continues from a state of the same episodes; returns its last observations."""
        if not isinstance(state, EpisodesState):
            found = type(state).__name__
            raise InputError(f"set_state: found {found}, expected a state of get_state")
        if state.environment != self._identity:
            what = f"the state is of {state.environment}; expected {self._identity}"
            raise InputError(f"set_state: {what}")
        for array, saved in zip(self._kept, state.arrays, strict=True):
            array[:] = saved
        return deepcopy(state.seen)

    @property
    def _identity(self) -> str:
        config = json.dumps(self.config, default=str)
        return f"{self.everyone.size} episodes of {self.name} with {config}"

    @property
    def _kept(self) -> tuple[NDArray[Any], ...]:
        """The arrays [B, ...] from which episodes continue."""
        scenes = self.scenes
        of_scenes = scenes.vehicles, scenes.order, scenes.generator, scenes.time, scenes.steps
        ranges = (each.ranges for each in self.observers if isinstance(each, Kinematics))
        return (*of_scenes, self.steps, *ranges)

    def step(self, actions: NDArray[Any] | tuple[NDArray[Any], ...]) -> Decision:
        """Carries out the egos' actions (B, ...), each one of `actions.space`.

        Those of several agents are a tuple.
        """
        scenes, rewards = self.scenes, self._rewards
        self.task.prepare(scenes, self.everyone)
        parts = actions if isinstance(actions, tuple) else (actions,)
        given = np.empty((self.everyone.size, len(parts)), dtype=np.int64)
        for ego, part in enumerate(parts):
            given[:, ego] = self.actions.give(scenes, self.everyone, part, ego)
        seen = self.observe() if self.task.observes_before else None
        decide(scenes, self.everyone, given, self._frames, self._interval)
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


def episodes_of_agents(road: NamedRoad, count: int, simulation_hz: int, room: int = 0) -> Episodes:
    """B scenes for agents with actions of their own, with the configuration of a road.

    Where the environment's actions are accelerations and steering angles, the ego starts as it does
    with meta-actions.
    """
    name = road.environment
    config: dict[str, Any] = {**(road.configuration or {}), "simulation_frequency": simulation_hz}
    if road.file is not None:
        config |= {"file": str(road.file), "sha256": road.sha256}
    is_continuous = DEFAULTS[name]["action"]["type"] == "ContinuousAction"
    if is_continuous and "DiscreteMetaAction" in _task_of(name).actions:
        config["action"] = {"type": "DiscreteMetaAction", "lateral": False}
    return Episodes(name, count, config, room)


def plan_of(lines: Lines, scenes: Scenes, b: int) -> Plan:
    """The plan of scene b, whose network has these lines."""
    vehicles = scenes.vehicles[b]
    return Plan(
        road=scenes.road,
        lines=lines,
        present=vehicles["kind"] != NOTHING,
        is_obstacle=np.isin(vehicles["kind"], (LANDMARK, OBSTACLE)),
        **{name: vehicles[name].copy() for name in OF_VEHICLES[1:]},
    )


def _task_of(name: str) -> type[Task]:
    module, class_name = (OF_FILES if name == FILE_ROAD else TASKS[name]).split(":")
    task: type[Task] = getattr(import_module(f"charms_bench.roads.{module}"), class_name)
    return task


def _check_egos(task: type[Task], config: Any) -> None:
    """Raises an `InputError` if several controlled vehicles are asked for where there is one."""
    given = config.get("controlled_vehicles", 1) if isinstance(config, Mapping) else 1
    if given != 1 and not task.can_have_egos:
        raise InputError(
            f"config.controlled_vehicles: {given!r}; this environment has one ego, whatever the "
            "number in highway-env; expected 1"
        )
