"""The seeds with which environments are reset."""

from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError


def checked_seed(seed: Any) -> int:
    """The seed of an episode.

    Raises:
        InputError: It is not an integer from 0 to 2**64 - 1.
    """
    try:
        found = _integer(seed)
    except TypeError:
        found = -1
    if not 0 <= found < 2**64:
        raise InputError(f"seed {seed!r}; expected an integer from 0 to 2**64 - 1")
    return found


def _integer(value: Any) -> int:
    if isinstance(value, bool):
        raise TypeError
    return index(value)


def seeds_of(seed: Any, count: int) -> list[int | None]:
    """The seeds of B environments: from `seed` on, or those in a list; None continues.

    Raises:
        InputError: One is out of range, or the list has another length.
    """
    if seed is None:
        return [None] * count
    try:
        first = _integer(seed)
    except TypeError:
        pass
    else:
        if first + count > 2**64:
            expected = f"expected an integer from 0 to 2**64 - {count}"
            raise InputError(f"reset: seed {seed!r} is that of the first of {count}; {expected}")
        return [checked_seed(first + k) for k in range(count)]
    try:
        each = list(seed)
    except TypeError:
        each = []
    if isinstance(seed, str) or len(each) != count:
        raise InputError(f"reset: seed {seed!r}; expected an integer, or {count} seeds")
    return [None if one is None else checked_seed(one) for one in each]


def random_seeds(count: int) -> NDArray[np.uint64]:
    """Seeds (B,) from the operating system."""
    return np.random.SeedSequence().generate_state(count, np.uint64).astype(np.uint64)
