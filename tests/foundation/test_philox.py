"""Philox: the numbers of NumPy's generator of that name."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from charms_bench.foundation.philox import uniforms

WORD = st.integers(0, 2**64 - 1)


@settings(deadline=None)  # the first call compiles
@given(
    counters=st.lists(st.tuples(WORD, WORD, WORD), min_size=1, max_size=4), count=st.integers(0, 11)
)
def test_each_row_has_the_numbers_of_numpys_generator(
    counters: list[tuple[int, int, int]], count: int
) -> None:
    keys, decisions, vehicles = np.array(counters, dtype=np.uint64).T
    found = uniforms(keys, decisions, vehicles, count)
    for row, (key, decision, vehicle) in zip(found, counters, strict=True):
        words = np.array([0, decision, vehicle, 0], dtype=np.uint64)
        bits = np.random.Philox(key=np.array([key, 0], dtype=np.uint64), counter=words)
        assert row.tolist() == np.random.Generator(bits).random(count).tolist()
