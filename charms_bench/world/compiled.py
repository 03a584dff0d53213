"""How the project compiles, and the arithmetic that compiled code shares."""

from typing import Any, TypeVar, cast

import numba
import numpy as np

F = TypeVar("F")


def compiled(function: F) -> F:
    """Compiles at the first call, caches on disk, releases the GIL; never uses fastmath."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined(function: F) -> F:
    """Compiles like `compiled`, and into each of its callers, so that their loops vectorise."""
    return cast(
        F, numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)
    )


@inlined
def index(value: int) -> Any:
    """An index that is not negative, as a type for which compiled code need not check that.

    Do not compute with it: in compiled code, its sum with an integer is a float.
    """
    return np.uint64(value)


@compiled
def clip(value: float, low: float, high: float) -> float:
    """The value, or the bound that it exceeds."""
    return min(max(value, low), high)


@compiled
def not_zero(value: float) -> float:
    """A divisor at least 0.01 away from zero [`utils.not_zero`]."""
    if abs(value) > 1e-2:
        return value
    return 1e-2 if value >= 0 else -1e-2
