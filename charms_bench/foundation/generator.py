"""NumPy's default random generator in compiled code; its state is an array, so it can be saved.

`numpy.random.default_rng(seed)` takes 12 µs, as long as 160 vehicles' simulation steps. This is the
same generator (O'Neill 2014, PCG XSL RR 128/64), seeded in the same way
(`numpy.random.SeedSequence`), and each function draws what the method of `numpy.random.Generator`
with its name draws.
"""

import math
from typing import Any

import numpy as np
from numba.np.random import _constants as ziggurat
from numpy.typing import NDArray

from charms_bench.foundation.compiled import compiled, inlined

Words = NDArray[np.uint64]
State = NDArray[np.uint64]
"""(6,) high and low word of the state, the same of its increment, the half of a word that the next
integer takes, and whether there is one. A state with given draws is longer; see `with_draws`."""
WORDS = 6

_LOW = np.uint64(0xFFFFFFFF)
_STRIP, _SIGN, _9, _PART = np.uint64(0xFF), np.uint64(0x100), np.uint64(9), np.uint64(2**52 - 1)
_1, _16, _32 = np.uint64(1), np.uint64(16), np.uint64(32)
_58, _63, _64 = np.uint64(58), np.uint64(63), np.uint64(64)
# SeedSequence's constants
_INIT_A, _MULTIPLIER_A = np.uint64(0x43B0D7E5), np.uint64(0x931E8875)
_INIT_B, _MULTIPLIER_B = np.uint64(0x8B51F9DD), np.uint64(0x58F38DED)
_MIX_LEFT, _MIX_RIGHT = np.uint64(0xCA01F9DD), np.uint64(0x4973F715)
# PCG64's multiplier
_HIGH_FACTOR, _LOW_FACTOR = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)


@compiled
def seeded(seeds: Words) -> State:
    """The states (R, 6) of `numpy.random.default_rng(seed)` for each of the seeds (R,)."""
    states = np.zeros((seeds.size, 6), dtype=np.uint64)
    key = np.empty(4, dtype=np.uint64)
    for r in range(seeds.size):
        _expand(seeds[r], key)
        # The increment is odd; the state is two steps from 0, with the key added in between.
        high_step, low_step = (key[2] << _1) | (key[3] >> _63), (key[3] << _1) | _1
        high, low = _add(high_step, low_step, key[0], key[1])
        states[r, 0], states[r, 1] = _advance(high, low, high_step, low_step)
        states[r, 2], states[r, 3] = high_step, low_step
    return states


def to_numpy(state: State) -> np.random.Generator:
    """NumPy's generator that continues from a state."""
    high, low, high_step, low_step, half, has_half = map(int, state)
    generator = np.random.PCG64(0)
    generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": high << 64 | low, "inc": high_step << 64 | low_step},
        "uinteger": half,
        "has_uint32": has_half,
    }
    return np.random.Generator(generator)


def from_numpy(generator: np.random.Generator) -> State:
    """The state of one of NumPy's default generators."""
    found: Any = generator.bit_generator.state
    words = divmod(found["state"]["state"], 2**64), divmod(found["state"]["inc"], 2**64)
    halves = found["uinteger"], found["has_uint32"]
    return np.array([*words[0], *words[1], *halves], dtype=np.uint64)


def with_draws(states: State, draws: NDArray[np.float64]) -> State:
    """The states (R, 7 + D) that first draw what is given, and then as the states (R, 6) do.

    The draws (R, D) are standard normal numbers. Each stands for one number, integer or normal
    number that is drawn; a uniform one is its value of the normal distribution function.
    """
    taken = np.zeros((len(states), 1), dtype=np.uint64)
    return np.concatenate((states, taken, draws.view(np.uint64)), axis=1)


@compiled
def has_draw(state: State) -> bool:
    """Whether the next draw is given."""
    return bool(state.size > WORDS and state[WORDS] < np.uint64(state.size - WORDS - 1))


@compiled
def given_draw(state: State) -> float:
    """The next given draw, a standard normal number."""
    taken = np.int64(state[WORDS])
    state[WORDS] = np.uint64(taken + 1)
    return float(state[WORDS + 1 :].view(np.float64)[taken])


@compiled
def given_word(state: State) -> np.uint64:
    """The next given draw as 64 bits."""
    probability = min(0.5 * math.erfc(-given_draw(state) / math.sqrt(2.0)), 1.0 - 2.0**-53)
    return np.uint64(probability * 2.0**53) << np.uint64(11)


@compiled
def word(state: State) -> np.uint64:
    """The next 64 random bits."""
    if has_draw(state):
        return given_word(state)
    state[0], state[1] = high, low = _advance(state[0], state[1], state[2], state[3])
    mixed, turn = high ^ low, high >> _58
    return (mixed >> turn) | (mixed << ((_64 - turn) & _63))


@compiled
def half_word(state: State) -> np.uint64:
    """The next 32 random bits."""
    if has_draw(state):
        return given_word(state) >> _32
    if state[5]:
        state[5] = np.uint64(0)
        return np.uint64(state[4])
    both = word(state)
    state[4], state[5] = both >> _32, _1
    return both & _LOW


@compiled
def random(state: State) -> float:
    """A number in [0, 1)."""
    return float(word(state) >> np.uint64(11)) * 2.0**-53


@compiled
def uniform(state: State, low: float, high: float) -> float:
    """A number in [low, high)."""
    return low + (high - low) * random(state)


@compiled
def uniform_for_integers(state: State, count: int) -> float:
    """A number in [0, 1) whose product with `count`, below 2**32, has `integers` as integer part.

    It is the accepted half word over 2**32 (Lemire 2019), so the product is exact.
    """
    if count == 1:
        return 0.0
    threshold = np.uint64(2**32 - count) % np.uint64(count)
    while True:
        half = half_word(state)
        if half * np.uint64(count) & _LOW >= threshold:
            return float(half) * 2.0**-32


@compiled
def integers(state: State, low: int, high: int) -> int:
    """An integer from `low` to `high` - 1; also `choice` from as many options."""
    return low + int(uniform_for_integers(state, high - low) * (high - low))


@compiled
def two_integers(state: State, high: int) -> tuple[int, int]:
    """Two different integers from 0 to `high` - 1 [`choice(high, 2, replace=False)`].

    NumPy draws them by Floyd's algorithm and then shuffles them.
    """
    one, other = integers(state, 0, high - 1), integers(state, 0, high)
    if other == one:
        other = high - 1
    if integers(state, 0, 2):
        return one, other
    return other, one


@compiled
def shuffle(state: State, rows: NDArray[Any]) -> None:
    """Shuffles the rows of an array of two dimensions."""
    for i in range(len(rows) - 1, 0, -1):
        mask = _LOW
        while mask >> _1 >= np.uint64(i):
            mask >>= _1
        j = half_word(state) & mask
        while j > np.uint64(i):
            j = half_word(state) & mask
        other = np.int64(j)
        for k in range(rows.shape[1]):  # rows that are assigned take a second more to compile
            rows[i, k], rows[other, k] = rows[other, k], rows[i, k]


@compiled
def choice(state: State, weights: NDArray[np.float64]) -> int:
    """An index below the number of `weights` (K,), with these probabilities, which add up to 1."""
    total = 0.0
    for weight in weights:
        total += weight
    drawn, until = random(state), 0.0
    for k in range(weights.size):
        until += weights[k]
        if drawn < until / total:
            break
    return int(k)


@compiled
def normal(state: State, mean: float, deviation: float) -> float:
    """A normally distributed number, by the ziggurat of Marsaglia & Tsang (2000).

    Beyond 3.65 standard deviations, it has the logarithms of the C library, like NumPy's.
    """
    if has_draw(state):
        return float(mean + deviation * given_draw(state))
    while True:
        bits = word(state)
        strip, part = bits & _STRIP, (bits >> _9) & _PART
        x = float(part) * ziggurat.wi_double[strip]
        x = -x if bits & _SIGN else x
        if part < ziggurat.ki_double[strip]:
            break
        if strip == 0:
            tail = twice = 0.0
            while twice <= tail * tail:
                tail = -ziggurat.ziggurat_nor_inv_r * math.log1p(-random(state))
                twice = -2.0 * math.log1p(-random(state))
            x = ziggurat.ziggurat_nor_r + tail
            x = -x if part & _SIGN else x
            break
        upper, lower = ziggurat.fi_double[strip - _1], ziggurat.fi_double[strip]
        if (upper - lower) * random(state) + lower < math.exp(-0.5 * x * x):
            break
    return float(mean + deviation * x)


@compiled
def _expand(seed: np.uint64, key: Words) -> None:
    """Fills `key` with four words from a seed [`SeedSequence.generate_state`]."""
    pool = np.zeros(4, dtype=np.uint64)
    pool[0], pool[1] = seed & _LOW, seed >> _32
    constant = _INIT_A
    for i in range(4):
        pool[i], constant = _hash(pool[i], constant, _MULTIPLIER_A)
    for source in range(4):
        for target in range(4):
            if source != target:
                hashed, constant = _hash(pool[source], constant, _MULTIPLIER_A)
                mixed = (_MIX_LEFT * pool[target] - _MIX_RIGHT * hashed) & _LOW
                pool[target] = mixed ^ (mixed >> _16)
    constant = _INIT_B
    for i in range(4):
        low, constant = _hash(pool[2 * i % 4], constant, _MULTIPLIER_B)
        high, constant = _hash(pool[(2 * i + 1) % 4], constant, _MULTIPLIER_B)
        key[i] = low | (high << _32)


@inlined
def _hash(
    value: np.uint64, constant: np.uint64, multiplier: np.uint64
) -> tuple[np.uint64, np.uint64]:
    """A hash of a value of 32 bits, and the constant of the next one."""
    following = (constant * multiplier) & _LOW
    value = ((value ^ constant) * following) & _LOW
    return value ^ (value >> _16), following


@inlined
def _advance(
    high: np.uint64, low: np.uint64, high_step: np.uint64, low_step: np.uint64
) -> tuple[np.uint64, np.uint64]:
    """The state times the multiplier plus the increment, modulo 2**128."""
    a, b, c, d = low & _LOW, low >> _32, _LOW_FACTOR & _LOW, _LOW_FACTOR >> _32
    middle = ((a * c) >> _32) + ((a * d) & _LOW) + b * c
    carried = b * d + ((a * d) >> _32) + (middle >> _32)
    product_high = carried + high * _LOW_FACTOR + low * _HIGH_FACTOR
    return _add(product_high, low * _LOW_FACTOR, high_step, low_step)


@inlined
def _add(
    high: np.uint64, low: np.uint64, other_high: np.uint64, other_low: np.uint64
) -> tuple[np.uint64, np.uint64]:
    """The sum of two numbers of 128 bits, modulo 2**128."""
    total = low + other_low
    carry = _1 if total < low else np.uint64(0)
    return high + other_high + carry, total
