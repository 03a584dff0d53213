"""What the egos observe: highway-env's observations by a configuration."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.arrays import Ints
from charms_bench.roads import kinematics, time_to_collision
from charms_bench.roads.configuration import options
from charms_bench.roads.scenes import Scenes
from charms_bench.world.scene import Observations

_LANE_WIDTH_M = 4.0
"""[`AbstractLane.DEFAULT_WIDTH`]"""
_RANGES = {"x": (-200.0, 200.0), "vx": (-80.0, 80.0), "vy": (-80.0, 80.0)}
"""What highway-env maps onto [-1, 1] by default; and the width of the ego's road for y."""
_KINEMATICS: dict[str, Any] = {
    "features": ["presence", "x", "y", "vx", "vy"],
    "vehicles_count": 5,
    "features_range": None,
    "absolute": False,
    "order": "sorted",
    "normalize": True,
    "clip": True,
    "see_behind": False,
    "observe_intentions": False,
    "include_obstacles": True,
}


class Observer(Protocol):
    """An observation of B scenes."""

    @property
    def shape(self) -> tuple[int, ...]:
        """That of one observation."""

    @property
    def low(self) -> float:
        """The least value of its space."""

    @property
    def high(self) -> float:
        """The largest value of its space."""

    def start(self, scenes: Scenes, rows: Ints) -> None:
        """Notes what highway-env keeps from the start of an episode."""

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        """The egos' observations of the scenes `rows` (R,)."""


class Kinematics:
    """[`KinematicObservation`, `ExitObservation`]"""

    low, high = -np.inf, np.inf

    def __init__(self, config: Mapping[str, Any], count: int, lanes: Mapping[Any, int]) -> None:
        observation = config["observation"]
        kind, exit_lane = str(observation["type"]), -1
        found = options("observation", observation, {"type": kind, **_KINEMATICS})
        if kind == "ExitObservation":
            exit_lane = lanes["1", "2", config["lanes_count"]]
            found |= {"order": "sorted", "include_obstacles": False}
        features = list(found["features"] or _KINEMATICS["features"])
        for name in features:
            if name not in kinematics.FEATURES:
                known = suggestion(name, dict.fromkeys(kinematics.FEATURES))
                what = f"'{name}' is not supported. {known}"
                raise InputError(f"config.observation.features: {what}")
        if found["order"] == "shuffled":
            raise InputError("config.observation.order: 'shuffled' is not supported")
        if not found["vehicles_count"] >= 2:
            raise InputError("config.observation.vehicles_count: expected at least 2")
        self.shape = int(found["vehicles_count"]), len(features)
        self._features = np.array([kinematics.FEATURES.index(name) for name in features])
        ranges = found["features_range"] or _RANGES
        ranges = ranges if found["normalize"] else {}
        bounds = [ranges.get(name, (np.nan, np.nan)) for name in features]
        self._ranges = np.tile(np.array(bounds, dtype=np.float64), (count, 1, 1))
        has_width = not found["features_range"] and found["normalize"]
        self._of_width = [k for k, name in enumerate(features) if name == "y" and has_width]
        flags = found["absolute"], found["order"] == "sorted", found["clip"], found["see_behind"]
        self._how = np.array([*flags, found["include_obstacles"], exit_lane], dtype=np.int64)
        self._out = np.zeros((count, *self.shape), dtype=np.float32)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        for k in self._of_width:
            lanes = scenes.road.lanes["lanes"][scenes.vehicles["lane"][rows, 0]]
            half = _LANE_WIDTH_M * lanes
            self._ranges[rows, k] = np.stack((-half, half), axis=1)

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        kinematics.observe(scenes, rows, self._features, self._ranges, self._how, self._out)
        return self._out[rows]


class TimeToCollision:
    """[`TimeToCollisionObservation`]"""

    low, high = 0.0, 1.0

    def __init__(self, config: Mapping[str, Any], count: int, lanes: Mapping[Any, int]) -> None:
        known = {"type": "TimeToCollision", "horizon": 10}
        found = options("observation", config["observation"], known)
        self._interval = 1 / config["policy_frequency"]
        sides = time_to_collision.SIDES
        self.shape = sides, sides, int(found["horizon"] / self._interval)
        self._out = np.zeros((count, *self.shape), dtype=np.float32)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        pass

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        time_to_collision.observe(scenes, rows, self._interval, self._out)
        return self._out[rows]


_OBSERVERS: dict[str, Callable[[Mapping[str, Any], int, Mapping[Any, int]], Observer]] = {
    "Kinematics": Kinematics,
    "ExitObservation": Kinematics,
    "TimeToCollision": TimeToCollision,
}


def observer_of(config: Mapping[str, Any], count: int, lanes: Mapping[Any, int]) -> Observer:
    """The observation of a configuration, for B = `count` scenes.

    `lanes` are the indices of the road's lanes by highway-env's names.

    Raises:
        InputError: The configuration is not supported.
    """
    name = config["observation"].get("type")
    if name not in _OBSERVERS or (name == "ExitObservation" and ("2", "exit", 0) not in lanes):
        known = suggestion(str(name), dict.fromkeys(_OBSERVERS))
        raise InputError(f"config.observation.type: '{name}' is not supported. {known}")
    return _OBSERVERS[name](config, count, lanes)
