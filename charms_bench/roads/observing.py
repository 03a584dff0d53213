"""What the egos observe: highway-env's observations by a configuration."""

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.arrays import Ints
from charms_bench.roads import attributes, goal, kinematics, occupancy_grid, time_to_collision
from charms_bench.roads.configuration import options
from charms_bench.roads.controls import kind_of_ego
from charms_bench.roads.scenes import COMMANDED, Scenes
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
    "type": "OccupancyGrid",
    "features": ["presence", "vx", "vy", "on_road"],
    "grid_size": [[-27.5, 27.5], [-27.5, 27.5]],
    "grid_step": [5, 5],
    "features_range": None,
    "absolute": False,
    "align_to_vehicle_axes": False,
    "clip": True,
    "as_image": False,
}


class Observer(Protocol):
    """An ego's observation of B scenes."""

    @property
    def space(self) -> gymnasium.Space[Any]:
        """Of one observation."""

    def start(self, scenes: Scenes, rows: Ints) -> None:
        """Notes what highway-env keeps from the start of an episode."""

    def observe(self, scenes: Scenes, rows: Ints) -> Observed:
        """The ego's observations of the scenes `rows` (R,)."""


class Kinematics:
    """[`KinematicObservation`, `ExitObservation`]"""

    def __init__(
        self, config: Mapping[str, Any], count: int, lanes: Mapping[Any, int], ego: int
    ) -> None:
        self._ego = ego
        observation = config["observation"]
        kind, exit_lane = str(observation["type"]), -1
        found = options("observation", observation, {"type": kind, **_KINEMATICS})
        if kind == "ExitObservation":
            exit_lane = lanes["1", "2", config["lanes_count"]]
            found |= {"include_obstacles": False}
        features = list(found["features"] or _KINEMATICS["features"])
        _check_features(features, kinematics.FEATURES)
        if not found["vehicles_count"] >= 2:
            raise InputError("config.observation.vehicles_count: expected at least 2")
        shape = int(found["vehicles_count"]), len(features)
        self.space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self._features = np.array([kinematics.FEATURES.index(name) for name in features])
        ranges = found["features_range"] or _RANGES
        ranges = ranges if found["normalize"] else {}
        bounds = [ranges.get(name, (np.nan, np.nan)) for name in features]
        self.ranges = np.tile(np.array(bounds, dtype=np.float64), (count, 1, 1))
        """(B, F, 2) the values that become -1 and 1; not a number for what is not scaled."""
        has_width = not found["features_range"] and found["normalize"]
        self._of_width = [k for k, name in enumerate(features) if name == "y" and has_width]
        order, is_exit = found["order"], kind == "ExitObservation"
        flags = found["absolute"], is_exit or order == "sorted", found["clip"], found["see_behind"]
        sees = found["include_obstacles"], found["observe_intentions"]
        self._how = np.array([*flags, *sees, order == "shuffled", exit_lane], dtype=np.int64)
        self._out = np.zeros((count, *shape), dtype=np.float32)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        for k in self._of_width:
            lanes = scenes.road.lanes["lanes"][scenes.vehicles["lane"][rows, self._ego]]
            half = _LANE_WIDTH_M * lanes
            self.ranges[rows, k] = np.stack((-half, half), axis=1)

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        how = self._features, self.ranges, self._how
        kinematics.observe(scenes, rows, self._ego, *how, self._out)
        return self._out[rows]


class TimeToCollision:
    """[`TimeToCollisionObservation`]"""

    def __init__(
        self, config: Mapping[str, Any], count: int, lanes: Mapping[Any, int], ego: int
    ) -> None:
        self._ego = ego
        known = {"type": "TimeToCollision", "horizon": 10}
        found = options("observation", config["observation"], known)
        self._interval = 1 / config["policy_frequency"]
        sides = time_to_collision.SIDES
        shape = sides, sides, int(found["horizon"] / self._interval)
        self.space = gymnasium.spaces.Box(0.0, 1.0, shape, np.float32)
        self._out = np.zeros((count, *shape), dtype=np.float32)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        pass

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        time_to_collision.observe(scenes, rows, self._ego, self._interval, self._out)
        return self._out[rows]


class OccupancyGrid:
    """[`OccupancyGridObservation`]"""

    def __init__(
        self, config: Mapping[str, Any], count: int, lanes: Mapping[Any, int], ego: int
    ) -> None:
        self._ego = ego
        found = options("observation", config["observation"], _GRID)
        if found["absolute"]:
            raise InputError("config.observation.absolute: True is not supported")
        names = list(found["features"])
        _check_features(names, (*kinematics.FEATURES, "on_road"))
        known = {name: k for k, name in enumerate(kinematics.FEATURES)}
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
        self._out = np.zeros((count, *shape), dtype=np.float32)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        pass

    def observe(self, scenes: Scenes, rows: Ints) -> Observations:
        how = self._features, self._ranges, self._grid
        occupancy_grid.observe(scenes, rows, self._ego, *how, self._out)
        return self._out[rows].astype(self._dtype)


class KinematicsGoal:
    """[`KinematicsGoalObservation`]"""

    def __init__(
        self, config: Mapping[str, Any], count: int, lanes: Mapping[Any, int], ego: int
    ) -> None:
        known = {"type": "KinematicsGoal", "scales": None, **_KINEMATICS}
        found = options("observation", config["observation"], known)
        self._features = list(found["features"] or _KINEMATICS["features"])
        _check_features(self._features, goal.FEATURES)
        self._scales = np.array(found["scales"], dtype=np.float64)
        if self._scales.shape != (len(self._features),):
            raise InputError("config.observation.scales: expected one number for each feature")
        box = gymnasium.spaces.Box(-np.inf, np.inf, self._scales.shape, np.float64)
        self.space = gymnasium.spaces.Dict(dict.fromkeys(_GOALS, box))

    def start(self, scenes: Scenes, rows: Ints) -> None:
        pass

    def observe(self, scenes: Scenes, rows: Ints) -> Observed:
        found = goal.achieved_and_desired(scenes, rows, self._features, self._scales)
        return dict(zip(_GOALS, (found[0].copy(), *found), strict=True))


class Attributes:
    """[`AttributesObservation`]"""

    def __init__(
        self, config: Mapping[str, Any], count: int, lanes: Mapping[Any, int], ego: int
    ) -> None:
        known = {"type": "AttributesObservation", "attributes": ()}
        self._names = list(options("observation", config["observation"], known)["attributes"])
        _check_features(self._names, attributes.ATTRIBUTES, "attributes")
        indices = [attributes.ATTRIBUTES.index(name) for name in self._names]
        self._attributes = np.array(indices, dtype=np.int64)
        self._noises = np.array([config["state_noise"], config["derivative_noise"]], np.float64)
        noisy = (self._attributes != attributes.REFERENCE_STATE).sum()
        self._skipped = 2 * attributes.NUMBERS * int(noisy)
        box = gymnasium.spaces.Box(-np.inf, np.inf, (attributes.NUMBERS, 1), np.float64)
        self.space = gymnasium.spaces.Dict(dict.fromkeys(self._names, box))
        self._out = np.zeros((count, len(self._names), attributes.NUMBERS))

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


_OBSERVERS: dict[str, Callable[[Mapping[str, Any], int, Mapping[Any, int], int], Observer]] = {
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
    """What the ego at a place observes by a configuration, for B = `count` scenes.

    `lanes` are the indices of the road's lanes by highway-env's names.

    Raises:
        InputError: The configuration is not supported.
    """
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
    return _OBSERVERS[name](config, count, lanes, ego)
