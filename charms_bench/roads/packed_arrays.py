"""Arrays of scenes as bytes, W for each scene, and back."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Ints

Array = NDArray[Any]
_LARGEST = 1e9
"""Bound of all numbers of a state, so that nothing overflows."""


def pack(arrays: Iterable[Array], rows: Ints) -> NDArray[np.uint8]:
    """The bytes (R, W) of the scenes `rows` (R,) of arrays [B, ...], one array after the other."""
    kept = (array[rows].astype(_without_padding(array.dtype)) for array in arrays)
    each = [array.reshape(rows.size, math.prod(array.shape[1:])) for array in kept]
    return np.concatenate([array.view(np.uint8) for array in each], axis=1)


def unpack(packed: NDArray[np.uint8], arrays: Mapping[str, Array]) -> dict[str, Array]:
    """What was packed of S scenes, [S, ...] by the names of arrays [B, ...] of the same kinds."""
    parts, start = {}, 0
    for name, array in arrays.items():
        kind = _without_padding(array.dtype)
        end = start + width_of((array,))
        part = np.ascontiguousarray(packed[:, start:end]).view(kind)
        parts[name], start = part.reshape(len(packed), *array.shape[1:]), end
    return parts


def width_of(arrays: Iterable[Array]) -> int:
    """W, the bytes per scene of arrays [B, ...]."""
    return sum(array[0].size * _without_padding(array.dtype).itemsize for array in arrays)


def check_values(
    parts: Mapping[str, Array], bounds: Mapping[str, tuple[float, float]], may_be_nan: str
) -> None:
    """Rejects what compiled code must not meet in arrays; the fields of records are `name.field`.

    `bounds` are those of arrays that have narrower ones than the others, and numbers can be missing
    where names begin with `may_be_nan`. An `InputError` says what is out of its bounds.
    """
    fields = {
        f"{name}.{field}" if field else name: part[field] if field else part
        for name, part in parts.items()
        for field in part.dtype.names or ("",)
    }
    for name, values in fields.items():
        low, high = bounds.get(name, (-_LARGEST, _LARGEST))
        if values.dtype.kind == "b":
            valid = values.view(np.uint8) <= 1
        else:
            valid = (low <= values) & (values <= high)
            valid |= name.startswith(may_be_nan) & np.isnan(values)
        if not valid.all():
            what = f"{low} to {high}" if name in bounds else "finite numbers"
            raise InputError(f"network: {name}: found {values[~valid][0]}, expected {what}")


def _without_padding(kind: np.dtype[Any]) -> np.dtype[Any]:
    """The type without the bytes between fields, which hold anything."""
    return np.dtype(repack_fields(kind)) if kind.names else kind
