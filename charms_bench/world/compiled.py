"""How the project compiles, and the arithmetic that compiled code shares."""

from typing import TypeVar, cast

import numba

F = TypeVar("F")


def compiled(function: F) -> F:
    """Compiles at the first call, caches on disk, releases the GIL; never uses fastmath."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined(function: F) -> F:
    """Compiles like `compiled`, and into each of its callers, so that their loops vectorise."""
    return cast(
        F, numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)
    )


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
