"""Counter-based random numbers: those of `numpy.random.Philox` for many counters at once.

Philox 4x64-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") makes each block
of four words from a key and a counter alone, so no generator has a state that would have to be kept
or saved.
"""

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.compiled import compiled, inlined

Words = NDArray[np.uint64]

_ROUNDS = 10
_LOW, _32 = np.uint64(0xFFFFFFFF), np.uint64(32)
_MULTIPLIERS = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_WEYL = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)


def uniforms(keys: Words, decisions: Words, vehicles: Words, count: int) -> NDArray[np.float64]:
    """Random numbers (M, count) in [0, 1), a row for each of M keys and counters (M,).

    Row m has the numbers of
    `Generator(Philox(key=[keys[m], 0], counter=[0, decisions[m], vehicles[m], 0])).random(count)`.
    """
    found = np.empty((keys.size, count))
    if count:
        _fill(keys, decisions, vehicles, found)
    return found


@compiled
def _fill(keys: Words, decisions: Words, vehicles: Words, found: NDArray[np.float64]) -> None:
    block = np.empty(4, dtype=np.uint64)
    for m in range(keys.size):
        for w in range(found.shape[1]):
            if w % 4 == 0:
                # NumPy counts before it makes a block.
                block[0], block[1] = np.uint64(w // 4 + 1), decisions[m]
                block[2], block[3] = vehicles[m], np.uint64(0)
                _mix(block, keys[m])
            found[m, w] = float(block[w % 4] >> np.uint64(11)) * 2.0**-53


@compiled
def _mix(block: Words, key: np.uint64) -> None:
    """Replaces a counter of four words by its random words."""
    one, other = key, np.uint64(0)
    for _ in range(_ROUNDS):
        high, low = _product(_MULTIPLIERS[0], block[0])
        other_high, other_low = _product(_MULTIPLIERS[1], block[2])
        block[0], block[1] = other_high ^ block[1] ^ one, other_low
        block[2], block[3] = high ^ block[3] ^ other, low
        one, other = one + _WEYL[0], other + _WEYL[1]


@inlined
def _product(a: np.uint64, b: np.uint64) -> tuple[np.uint64, np.uint64]:
    """The upper and the lower word of a product."""
    low, middle = (a & _LOW) * (b & _LOW), (a >> _32) * (b & _LOW)
    carried = (a & _LOW) * (b >> _32) + (low >> _32) + (middle & _LOW)
    return (a >> _32) * (b >> _32) + (middle >> _32) + (carried >> _32), a * b
