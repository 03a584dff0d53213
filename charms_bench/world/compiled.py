"""How the project compiles, and the arithmetic that compiled code shares."""

import weakref
from collections.abc import Callable
from functools import update_wrapper
from typing import Any, TypeVar, cast

import numba
import numpy as np

F = TypeVar("F")
_Known = tuple[Callable[[], Any], int, dict[Any, Any]]
"""A scene's position, held weakly, the scene's identity and its machine code by other types."""


def compiled(function: F) -> F:
    """Compiles at the first call, caches on disk, releases the GIL; never uses fastmath."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined(function: F) -> F:
    """Compiles like `compiled`, and into each of its callers, so that their loops vectorise."""
    return cast(
        F, numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)
    )


class _OfScenes:
    """A compiled function whose first argument is a scene.

    At every call, numba looks up the machine code by the types of all arguments, which takes 5 µs
    for the arrays of a scene, and much longer for read-only ones. This remembers the machine code
    for two scenes, which are mostly a simulation's own scene and the one that it shows to agents.
    """

    def __init__(self, function: Any) -> None:
        update_wrapper(self, function)
        self._function = compiled(function)
        self._last: tuple[_Known, _Known] = ((lambda: None, 0, {}), (lambda: None, 0, {}))

    def __call__(self, scene: Any, *others: Any) -> Any:
        recent, earlier = self._last  # read at once, because threads share it
        if recent[0]() is not scene.x or recent[1] != id(scene):
            if earlier[0]() is not scene.x or earlier[1] != id(scene):
                # The position is held weakly, so that this keeps no scene alive.
                earlier = (weakref.ref(scene.x), id(scene), {})
            self._last = recent, earlier = earlier, recent
        codes = recent[2]
        types = tuple(map(_type, others))
        if types not in codes:
            signature = tuple(map(numba.typeof, (scene, *others)))
            self._function.compile(signature)
            codes[types] = self._function.overloads[signature].entry_point
        return codes[types](scene, *others)


_LAYOUT = 0x1 | 0x2 | 0x100 | 0x400
"""NumPy's flags that decide an array's type: contiguous (C, Fortran), aligned, writable."""


def _type(value: Any) -> Any:
    """What decides an argument's type in compiled code."""
    if type(value) is not np.ndarray:
        return type(value)
    return value.dtype, value.ndim, value.flags.num & _LAYOUT


def compiled_of_scenes(function: F) -> F:
    """Compiles like `compiled` a function of a scene that Python calls often.

    Compiled code cannot call it. A tuple among its arguments must be a named tuple whose fields
    always have the same types.
    """
    return cast(F, _OfScenes(function))


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
