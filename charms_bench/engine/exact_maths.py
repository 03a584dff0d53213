"""Makes highway-env compute the same bits on every x86-64 processor, in worker processes."""

import os
import platform
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from charms_bench.engine import EngineName
from charms_bench.world import maths

_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS")
ONE_THREAD = dict.fromkeys(_THREADS, "1")
"""Environment variables of a process that computes on one thread."""
_OPENBLAS = "OPENBLAS_CORETYPE"
_CORE_TYPE = "Nehalem"
"""A core type without fused multiply-add, which every processor with SSE4.2 supports."""
_IS_X86 = platform.machine() in ("x86_64", "AMD64")
_MODULES = (
    "road.lane",
    "road.road",
    "utils",
    "vehicle.behavior",
    "vehicle.controller",
    "vehicle.kinematics",
    "vehicle.objects",
)
"""The modules of highway-env that move vehicles."""


def worker_environment(engine: EngineName) -> dict[str, str]:
    """Returns the environment variables with which a worker process has to be started.

    highway-env's vehicles use dot products of NumPy arrays, which cannot be replaced. OpenBLAS
    rounds each product in them or not, depending on the processor. For that engine, it has to round
    them. OpenBLAS reads this setting when it is loaded. On other processors than x86-64, there is
    no such setting, and bits may differ.
    """
    if engine == "batched" or not _IS_X86:
        return ONE_THREAD
    return {**ONE_THREAD, _OPENBLAS: _CORE_TYPE}


def use_exact_maths(engine: EngineName) -> None:
    """Makes highway-env's vehicles in this process use `charms_bench.world.maths`.

    Otherwise their bits would be those of NumPy and of the C library, which both choose their
    functions by the processor. Nothing is changed for the engine `batched`.

    Raises:
        RuntimeError: The process was not started with `worker_environment(engine)`.
    """
    if engine == "batched":
        return
    if _IS_X86 and os.environ.get(_OPENBLAS) != _CORE_TYPE:
        raise RuntimeError("the engine highway-env needs a process with exact maths")
    for name in _MODULES:
        import_module(f"highway_env.{name}").np = _numpy  # type: ignore[attr-defined]


class _Numpy(ModuleType):
    """NumPy with the elementary functions of `charms_bench.world.maths`, for numbers."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    @staticmethod
    def sin(x: float) -> np.float64:
        return np.float64(maths.sin(x))

    @staticmethod
    def cos(x: float) -> np.float64:
        return np.float64(maths.cos(x))

    @staticmethod
    def tan(x: float) -> np.float64:
        return np.float64(maths.tan(x))

    @staticmethod
    def arcsin(x: float) -> np.float64:
        return np.float64(maths.asin(x))

    @staticmethod
    def arctan(x: float) -> np.float64:
        return np.float64(maths.atan(x))

    @staticmethod
    def exp(x: float) -> np.float64:
        return np.float64(maths.exp(x))

    @staticmethod
    def power(x: float, y: float) -> np.float64:
        return np.float64(x * x if y == 2 else maths.power(x, y))


_numpy = _Numpy("numpy")
