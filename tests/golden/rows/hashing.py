"""Hashes of columns and arrays, the same on every machine."""

from hashlib import blake2b
from typing import Any

import numpy as np
import polars as pl


def hash_of(column: pl.Series) -> str:
    """Returns 8 hexadecimal digits for the values of a column, and for which are missing."""
    digest = blake2b(digest_size=4)
    if column.null_count():
        digest.update(column.is_null().to_numpy().tobytes())
    if column.dtype == pl.String:
        digest.update("\0".join(column.fill_null("")).encode())
    else:
        digest.update(bytes_of(column.cast(pl.Float64).to_numpy()))
    return digest.hexdigest()


def bytes_of(numbers: np.ndarray) -> bytes:
    """Returns the bytes of numbers as float64, with one zero and one NaN."""
    numbers = np.asarray(numbers, "<f8") + 0.0
    return np.where(np.isnan(numbers), np.nan, numbers).astype("<f8").tobytes()


class Digests:
    """Hashes of arrays that come one after the other, by name."""

    def __init__(self) -> None:
        self._of: dict[str, Any] = {}

    def add(self, **arrays: Any) -> None:
        """Adds arrays."""
        for name, values in arrays.items():
            digest = self._of.setdefault(name, blake2b(digest_size=4))
            digest.update(bytes_of(np.asarray(values, np.float64)))

    def values(self) -> dict[str, str]:
        """Returns the hashes."""
        return {name: digest.hexdigest() for name, digest in self._of.items()}
