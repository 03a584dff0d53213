"""How the project compiles: one decorator, so that every kernel follows the same rules."""

from typing import TypeVar, cast

import numba

F = TypeVar("F")


def compiled(function: F) -> F:
    """Compiles at the first call, caches on disk, releases the GIL; never fastmath."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
