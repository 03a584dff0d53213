"""What the egos observe: highway-env's observations by a configuration."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.arrays import Ints
from charms_bench.roads import attributes_observation as attributes
from charms_bench.roads import goal_observation as goal
from charms_bench.roads import kinematics_observation as kinematics
from charms_bench.roads import occupancy_grid_observation as occupancy_grid
from charms_bench.roads import time_to_collision_observation as time_to_collision
from charms_bench.roads.configuration import options
from charms_bench.roads.continuous_actions import kind_of_ego
from charms_bench.roads.scenes import COMMANDED, Scenes
from charms_bench.world.kinematics_observation import FEATURES
from charms_bench.world.scene import Observations

Observed = NDArray[Any] | dict[str, NDArray[Any]]
"""Observations (R, ...), or a dictionary of them."""
_LANE_WIDTH_M = 4.0
"""[`AbstractLane.DEFAULT_WIDTH`]"""
_SPEED_RANGES = {"vx": (-80.0, 80.0), "vy": (-80.0, 80.0)}
_RANGES = {"x": (-200.0, 200.0), **_SPEED_RANGES}
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
    "flatten": False,  # without effect, as in highway-env
}
_GOALS = ("observation", "achieved_goal", "desired_goal")
_GRID: dict[str, Any] = {
    "features": ["presence", "vx", "vy", "on_road"],
    "grid_size": [[-27.5, 27.5], [-27.5, 27.5]],
    "grid_step": [5, 5],
    "features_range": None,
    "absolute": False,
    "align_to_vehicle_axes": False,
    "clip": True,
    "as_image": False,
}


class Asked(NamedTuple):
    """Which ego observes what, by a configuration."""

    config: Mapping[str, Any]
    scenes: int
    """B."""
    lanes: Mapping[Any, int]
    """The indices of the road's lanes by highway-env's names."""
    ego: int = 0
    """The ego's place."""

    def options(self, known: Mapping[str, Any]) -> dict[str, Any]:
        """Those of the observation, which may have these, of which the values are the defaults."""
        given = self.config["observation"]
        return options("observation", given, {"type": given["type"], **known})


class Observer(ABC):
    """An ego's observation of B scenes; raises an `InputError` if it is not supported."""

    space: gymnasium.Space[Any]
    """Of one observation."""

    @abstractmethod
    def __init__(self, asked: Asked) -> None: ...

    def start(self, scenes: Scenes, rows: Ints) -> None:  # noqa: B027  # most keep nothing
        """Notes what highway-env keeps from the start of an episode."""

    @abstractmethod
    def observe(self, scenes: Scenes, rows: Ints) -> Observed:
        """The ego's observations of the scenes `rows` (R,)."""


class Kinematics(Observer):
    """[`KinematicObservation`, `ExitObservation`]"""

    def __init__(self, asked: Asked) -> None:
        self._ego, exit_lane = asked.ego, -1
        found = asked.options(_KINEMATICS)
        is_exit = found["type"] == "ExitObservation"
        if is_exit:
            exit_lane = asked.lanes["1", "2", asked.config["lanes_count"]]
            found["include_obstacles"] = False
        features = list(found["features"] or _KINEMATICS["features"])
        _check_features(features, FEATURES)
        if not found["vehicles_count"] >= 2:
            raise InputError("config.observation.vehicles_count: expected at least 2")
        shape = int(found["vehicles_count"]), len(features)
        self.space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self._features = np.array([FEATURES.index(name) for name in features])
        ranges = found["features_range"] or _RANGES
        ranges = ranges if found["normalize"] else {}
        bounds = [ranges.get(name, (np.nan, np.nan)) for name in features]
        self.ranges = np.tile(np.array(bounds, dtype=np.float64), (asked.scenes, 1, 1))
        """(B, F, 2) the values that become -1 and 1; not a number for what is not scaled."""
        has_width = not found["features_range"] and found["normalize"]
        self._of_width = [k for k, name in enumerate(features) if name == "y" and has_width]
        order = found["order"]
        flags = found["absolute"], is_exit or order == "sorted", found["clip"], found["see_behind"]
        sees = found["include_obstacles"], found["observe_intentions"]
        self._how = np.array([*flags, *sees, order == "shuffled", exit_lane], dtype=np.int64)
        self._out = np.zeros((asked.scenes, *shape), dtype=np.float32)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        for k in self._of_width:
            lanes = scenes.road.lanes["lanes"][scenes.vehicles["lane"][rows, self._ego]]
            half = _LANE_WIDTH_M * lanes
            self.ranges[rows, k] = np.stack((-half, half), axis=1)

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        how = self._features, self.ranges, self._how
        kinematics.observe(scenes, rows, self._ego, *how, self._out)
        return self._out[rows]


class TimeToCollision(Observer):
    """[`TimeToCollisionObservation`]"""

    def __init__(self, asked: Asked) -> None:
        self._ego, found = asked.ego, asked.options({"horizon": 10})
        self._interval = 1 / asked.config["policy_frequency"]
        sides = time_to_collision.SIDES
        shape = sides, sides, int(found["horizon"] / self._interval)
        self.space = gymnasium.spaces.Box(0.0, 1.0, shape, np.float32)
        self._out = np.zeros((asked.scenes, *shape), dtype=np.float32)

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        time_to_collision.observe(scenes, rows, self._ego, self._interval, self._out)
        return self._out[rows]


class OccupancyGrid(Observer):
    """[`OccupancyGridObservation`]"""

    def __init__(self, asked: Asked) -> None:
        self._ego, found = asked.ego, asked.options(_GRID)
        if found["absolute"]:
            raise InputError("config.observation.absolute: True is not supported")
        names = list(found["features"])
        _check_features(names, (*FEATURES, "on_road"))
        known = {name: k for k, name in enumerate(FEATURES)}
        indices = [known.get(name, occupancy_grid.ON_ROAD) for name in names]
        self._features = np.array(indices, dtype=np.int64)
        self._ranges = np.full((len(known), 2), np.nan)
        for name, bounds in (found["features_range"] or _SPEED_RANGES).items():
            if name in known:
                self._ranges[known[name]] = bounds
        size, step = np.array(found["grid_size"]), np.array(found["grid_step"])
        shape = len(names), *np.floor((size[:, 1] - size[:, 0]) / step).astype(int).tolist()
        is_image = bool(found["as_image"])
        low, high = (0, 255) if is_image else (-np.inf, np.inf)
        self._dtype: Any = np.uint8 if is_image else np.float32
        self.space = gymnasium.spaces.Box(low, high, shape, self._dtype)
        numbers: Any = *size[:, 0], *step, step.min(), 1 + np.hypot(*np.abs(size).max(axis=1))
        self._grid = occupancy_grid.Grid._make(
            (
                *map(float, numbers),
                *(bool(found[flag]) for flag in ("align_to_vehicle_axes", "clip", "as_image")),
            )
        )
        self._out = np.zeros((asked.scenes, *shape), dtype=np.float32)

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        how = self._features, self._ranges, self._grid
        occupancy_grid.observe(scenes, rows, self._ego, *how, self._out)
        return self._out[rows].astype(self._dtype)


class KinematicsGoal(Observer):
    """[`KinematicsGoalObservation`]"""

    def __init__(self, asked: Asked) -> None:
        found = asked.options({"scales": None, **_KINEMATICS})
        features = list(found["features"] or _KINEMATICS["features"])
        _check_features(features, goal.FEATURES)
        self._features = np.array([goal.FEATURES.index(name) for name in features])
        self._scales = np.array(found["scales"], dtype=np.float64)
        if self._scales.shape != self._features.shape:
            raise InputError("config.observation.scales: expected one number for each feature")
        box = gymnasium.spaces.Box(-np.inf, np.inf, self._scales.shape, np.float64)
        self.space = gymnasium.spaces.Dict(dict.fromkeys(_GOALS, box))

    def observe(self, scenes: Scenes, rows: Ints) -> Observed:
        found = np.empty((2, rows.size, self._features.size))
        goal.observe(scenes, rows, self._features, self._scales, found)
        return dict(zip(_GOALS, (found[0].copy(), *found), strict=True))


class Attributes(Observer):
    """[`AttributesObservation`]"""

    def __init__(self, asked: Asked) -> None:
        self._names = list(asked.options({"attributes": ()})["attributes"])
        _check_features(self._names, attributes.ATTRIBUTES, "attributes")
        indices = [attributes.ATTRIBUTES.index(name) for name in self._names]
        self._attributes = np.array(indices, dtype=np.int64)
        self._noises = np.array(
            [asked.config[f"{name}_noise"] for name in ("state", "derivative")], np.float64
        )
        noisy = (self._attributes != attributes.REFERENCE_STATE).sum()
        self._skipped = 2 * attributes.NUMBERS * int(noisy)
        box = gymnasium.spaces.Box(-np.inf, np.inf, (attributes.NUMBERS, 1), np.float64)
        self.space = gymnasium.spaces.Dict(dict.fromkeys(self._names, box))
        self._out = np.zeros((asked.scenes, len(self._names), attributes.NUMBERS))

    def start(self, scenes: Scenes, rows: Ints) -> None:
        attributes.skip(scenes, rows, self._skipped)

    def observe(self, scenes: Scenes, rows: Ints) -> Observed:
        attributes.observe(scenes, rows, self._attributes, self._noises, self._out)
        return {name: self._out[rows, k, :, None] for k, name in enumerate(self._names)}


def _check_features(names: Iterable[str], known: Collection[str], key: str = "features") -> None:
    """Rejects the first of the names that is not known."""
    for name in names:
        if name not in known:
            what = f"'{name}' is not supported. {suggestion(name, dict.fromkeys(known))}"
            raise InputError(f"config.observation.{key}: {what}")


_OBSERVERS: dict[str, type[Observer]] = {
    "Kinematics": Kinematics,
    "ExitObservation": Kinematics,
    "TimeToCollision": TimeToCollision,
    "OccupancyGrid": OccupancyGrid,
    "KinematicsGoal": KinematicsGoal,
    "AttributesObservation": Attributes,
}


def observer_of(
    config: Mapping[str, Any], count: int, lanes: Mapping[Any, int], ego: int = 0
) -> Observer:
    """What the ego at a place observes by a configuration, for B = `count` scenes; see `Asked`."""
    name = config["observation"].get("type")
    known = dict(_OBSERVERS)
    if ("2", "exit", 0) not in lanes:
        del known["ExitObservation"]
    if kind_of_ego(config) != COMMANDED:
        del known["TimeToCollision"]  # it reads the ego's target speeds
    if "reward_weights" not in config:
        del known["KinematicsGoal"]  # there is no goal
    if "state_noise" not in config:
        del known["AttributesObservation"]  # there is no state
    if name not in known:
        what = suggestion(str(name), known)
        raise InputError(f"config.observation.type: '{name}' is not supported. {what}")
    return _OBSERVERS[name](Asked(config, count, lanes, ego))
