"""Makes highway-env compute the same bits on every x86-64 processor.

NumPy and the C library choose their elementary functions by the processor. Here, highway-env's
modules get those of `charms_bench.foundation.maths` instead, which only add, multiply, divide and
take square roots. Dot products of NumPy arrays cannot be replaced: OpenBLAS has to be told not to
fuse their multiplications and additions, which it reads from `ENVIRONMENT` when it is loaded.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType
from typing import Any

import highway_env  # noqa: F401  # registers its environments
import numpy as np

from charms_bench.foundation import maths

ENVIRONMENT = {"OPENBLAS_CORETYPE": "Nehalem", "OPENBLAS_NUM_THREADS": "1"}
_FUNCTIONS = {
    "sin": maths.sin,
    "cos": maths.cos,
    "tan": maths.tan,
    "arcsin": maths.asin,
    "arctan": maths.atan,
    "arctan2": maths.atan2,
    "exp": maths.exp,
    "power": lambda x, y: x * x if y == 2 else maths.power(x, y),
}
_IDM_CONSTANTS = "DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN"


def restart_with(environment: dict[str, str]) -> None:
    """Starts this script again, unless these environment variables are set already."""
    if any(os.environ.get(name) != value for name, value in environment.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **environment})


def use_portable_mathematics() -> None:
    """Replaces what highway-env computes with, in this process."""
    assert all(os.environ.get(name) == value for name, value in ENVIRONMENT.items())
    portable = ModuleType("numpy")
    vars(portable).update(vars(np))
    for name, function in _FUNCTIONS.items():
        setattr(portable, name, _of_numpy(function))
    for module in [each for name, each in sys.modules.items() if name.startswith("highway_env")]:
        if getattr(module, "np", None) is np:
            module.np = portable
    # NumPy and Python square a number by `pow` of the C library: products instead.
    spline: Any = import_module("highway_env.road.spline")
    pose = spline.CurvePose
    spline.CurvePose = lambda x, y, dx, dy: pose(x, y, np.array([dx]), np.array([dy]))
    track: Any = import_module("highway_env.envs.racetrack_env").RacetrackEnv
    track._rewards = _rewards_of(track._rewards)
    import_module("highway_env.envs.lane_keeping_env").LaneKeepingEnv._reward = _reward_in_lane
    linear: Any = import_module("highway_env.vehicle.behavior").LinearVehicle
    linear.steering_features = _features_of(linear.steering_features)


@contextmanager
def unchanged_idm() -> Iterator[None]:
    """Restores the constants that `IntersectionEnv` changes for the whole process."""
    module: Any = import_module("highway_env.vehicle.behavior")
    names = "IDMVehicle", "LinearVehicle", "AggressiveVehicle", "DefensiveVehicle"
    kinds = [getattr(module, name) for name in names]
    before = [
        {name: vars(kind)[name] for name in _IDM_CONSTANTS if name in vars(kind)} for kind in kinds
    ]
    try:
        yield
    finally:
        for kind, values in zip(kinds, before, strict=True):
            for name in _IDM_CONSTANTS:
                if name in values:
                    setattr(kind, name, values[name])
                elif name in vars(kind):
                    delattr(kind, name)


def _of_numpy(function: Any) -> Any:
    """The function with NumPy's type of result, which divides by zero without an exception."""
    return lambda *numbers: np.float64(function(*map(float, numbers)))


def _rewards_of(rewards: Any) -> Any:
    """[`RacetrackEnv._rewards`]"""

    def exact(env: Any, action: Any) -> dict[str, Any]:
        _, lateral = env.vehicle.lane.local_coordinates(env.vehicle.position)
        centring = 1 / (1 + env.config["lane_centering_cost"] * (lateral * lateral))
        return {**rewards(env, action), "lane_centering_reward": centring}

    return exact


def _reward_in_lane(env: Any, action: Any) -> Any:
    """[`LaneKeepingEnv._reward`]"""
    _, lateral = env.lane.local_coordinates(env.vehicle.position)
    part = lateral / env.lane.width
    return 1 - part * part


def _features_of(features: Any) -> Any:
    """[`LinearVehicle.steering_features`]"""
    not_zero = import_module("highway_env.utils").not_zero

    def exact(vehicle: Any, target: Any) -> Any:
        heading, _ = features(vehicle, target)
        lane, speed = vehicle.road.network.get_lane(target), not_zero(vehicle.speed)
        _, lateral = lane.local_coordinates(vehicle.position)
        return np.array([heading, -lateral * vehicle.LENGTH / (speed * speed)])

    return exact
