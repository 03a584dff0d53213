"""How the project compiles, and the arithmetic that compiled code shares."""

from functools import update_wrapper
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.experimental import structref

F = TypeVar("F")


def compiled(function: F) -> F:
    """Compiles at the first call, caches on disk, releases the GIL; never uses fastmath."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined(function: F) -> F:
    """Compiles like `compiled`, and into each of its callers, so that their loops vectorise."""
    return cast(
        F, numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)
    )


@structref.register
class _UnpackedType(types.StructRef):
    """The type of `Unpacked` in compiled code."""


class Unpacked(structref.StructRefProxy):
    """A scene as compiled code holds it, in the one field `scene`.

    At every call, numba looks up the types of all arrays and constants of a scene and unpacks them,
    which takes 6 µs. Of this object, it unpacks one pointer.
    """


structref.define_proxy(Unpacked, _UnpackedType, ["scene"])  # type: ignore[no-untyped-call]


@compiled
def unpacked(scene: Any) -> Unpacked:
    """Unpacks a scene; see `Scene.unpacked`."""
    return Unpacked(scene)  # type: ignore[no-untyped-call]


def _call(unpacked: Any, *others: Any) -> Any:
    """What Python calls instead of `_function`, which `compiled_of_scenes` fills in."""
    return _function(unpacked.scene, *others)  # type: ignore[name-defined]  # noqa: F821


def compiled_of_scenes(function: F) -> F:
    """Compiles like `compiled` a function of a scene that Python calls often.

    Compiled code cannot call it.
    """
    plain: Any = function
    # numba's cache finds this file by it, and compiles again when the file has changed.
    code = _call.__code__.replace(co_filename=plain.__code__.co_filename)
    entry: Any = update_wrapper(FunctionType(code, {"_function": compiled(function)}), plain)
    del entry.__wrapped__
    call = compiled(entry)

    def of_scene(scene: Any, *others: Any) -> Any:
        return call(scene.unpacked, *others)

    return cast(F, update_wrapper(of_scene, plain))


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
