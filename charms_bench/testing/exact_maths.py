"""Makes highway-env compute the same bits on every x86-64 processor, in worker processes."""

import os
import platform
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from charms_bench.foundation import maths
from charms_bench.foundation.threads import ONE_THREAD

_OPENBLAS = "OPENBLAS_CORETYPE"
_CORE_TYPE = "Nehalem"
"""A core type without fused multiply-add, which every processor with SSE4.2 supports."""
_IS_X86 = platform.machine() in ("x86_64", "AMD64")
_MODULES = (
    "envs.common.observation",
    "envs.exit_env",
    "envs.highway_env",
    "envs.intersection_env",
    "envs.lane_keeping_env",
    "envs.merge_env",
    "envs.parking_env",
    "envs.racetrack_env",
    "envs.roundabout_env",
    "envs.two_way_env",
    "envs.u_turn_env",
    "road.lane",
    "road.road",
    "utils",
    "vehicle.behavior",
    "vehicle.controller",
    "vehicle.dynamics",
    "vehicle.kinematics",
    "vehicle.objects",
)
"""The modules of highway-env that compute."""
TOLERANCE = 0.0 if _IS_X86 else 1e-6
"""The largest difference between equal engines; other processors may round dot products."""


def worker_environment() -> dict[str, str]:
    """Returns the environment variables with which a worker process has to be started.

    highway-env's vehicles use dot products of NumPy arrays, which cannot be replaced. OpenBLAS
    rounds each product in them or not, depending on the processor. Here, it has to round them.
    OpenBLAS reads this setting when it is loaded. On other processors than x86-64, there is no such
    setting, and bits may differ.
    """
    if not _IS_X86:
        return ONE_THREAD
    return {**ONE_THREAD, _OPENBLAS: _CORE_TYPE}


def use_exact_maths() -> None:
    """Makes highway-env in this process use `charms_bench.foundation.maths`.

    Otherwise its bits would be those of NumPy and of the C library, which both choose their
    functions by the processor. Raises a `RuntimeError` if the process was not started with
    `worker_environment()`.
    """
    if _IS_X86 and os.environ.get(_OPENBLAS) != _CORE_TYPE:
        raise RuntimeError("highway-env needs a process with exact maths")
    _replace_functions()


@cache
def _replace_functions() -> None:
    """Replaces what vehicles, lanes and environments compute with, once."""
    for name in _MODULES:
        replaced = vars(import_module(f"highway_env.{name}"))
        replaced["np"], replaced["sum"] = _numpy, _sum
    spline: Any = import_module("highway_env.road.spline")
    spline.CurvePose = _of_arrays(spline.CurvePose)
    track: Any = import_module("highway_env.envs.racetrack_env").RacetrackEnv
    track._rewards = _without_power(track._rewards)
    keeping: Any = import_module("highway_env.envs.lane_keeping_env").LaneKeepingEnv
    keeping._reward = _reward_for_keeping_a_lane
    linear: Any = import_module("highway_env.vehicle.behavior").LinearVehicle
    linear.steering_features = _of_a_product(linear.steering_features)


def _sum(numbers: Iterable[Any]) -> Any:
    """As `sum` before Python 3.12, which then began to make up for what rounding loses."""
    total: Any = 0
    for each in numbers:
        total += each
    return total


class _Numpy(ModuleType):
    """NumPy with the elementary functions of `charms_bench.foundation.maths`, for numbers."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    @staticmethod
    def power(x: float, y: float) -> np.float64:
        return np.float64(x * x if y == 2 else maths.power(x, y))


def _of_arrays(pose: Any) -> Any:
    """`CurvePose`, but of arrays: NumPy squares a number by `pow` of the C library."""
    return lambda x, y, dx, dy: pose(x, y, np.array([dx]), np.array([dy]))


def _without_power(rewards: Any) -> Any:
    """`RacetrackEnv._rewards`, but with a product: Python squares a number by `pow`, too."""

    def exact_rewards(env: Any, action: Any) -> dict[str, Any]:
        _, lateral = env.vehicle.lane.local_coordinates(env.vehicle.position)
        centring = 1 / (1 + env.config["lane_centering_cost"] * (lateral * lateral))
        return {**rewards(env, action), "lane_centering_reward": centring}

    return exact_rewards


def _of_a_product(features: Any) -> Any:
    """`LinearVehicle.steering_features`, but with a product."""
    not_zero: Any = import_module("highway_env.utils").not_zero

    def exact_features(vehicle: Any, target: Any) -> Any:
        heading, _ = features(vehicle, target)
        lane, speed = vehicle.road.network.get_lane(target), not_zero(vehicle.speed)
        _, lateral = lane.local_coordinates(vehicle.position)
        return np.array([heading, -lateral * vehicle.LENGTH / (speed * speed)])

    return exact_features


def _reward_for_keeping_a_lane(env: Any, action: Any) -> Any:
    """`LaneKeepingEnv._reward`, but with a product."""
    _, lateral = env.lane.local_coordinates(env.vehicle.position)
    part = lateral / env.lane.width
    return 1 - part * part


def _for_numpy(function: Callable[..., float]) -> Callable[..., np.float64]:
    """The function with NumPy's type of result, which divides by zero without an exception."""
    return lambda *numbers: np.float64(function(*map(float, numbers)))


_numpy = _Numpy("numpy")
_FUNCTIONS: dict[str, Callable[..., float]] = {
    "sin": maths.sin,
    "cos": maths.cos,
    "tan": maths.tan,
    "arcsin": maths.asin,
    "arctan": maths.atan,
    "arctan2": maths.atan2,
    "exp": maths.exp,
}
for _name, _function in _FUNCTIONS.items():
    setattr(_numpy, _name, _for_numpy(_function))
