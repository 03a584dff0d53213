"""The words are those of NumPy's default generator."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from charms_bench.foundation.random_words import random_words


@settings(deadline=None)
@given(st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=4), st.integers(1, 200))
def test_words_are_those_of_numpys_generator(seeds: list[int], count: int) -> None:
    words = random_words(np.array(seeds, dtype=np.uint64), count)
    expected = [np.random.PCG64(seed).random_raw(count) for seed in seeds]
    np.testing.assert_array_equal(words, expected)


def test_small_seeds_have_the_words_of_numpys_generator() -> None:
    seeds = np.array([0, 1, 2**32 - 1, 2**32, 2**63], dtype=np.uint64)
    expected = [np.random.default_rng(int(seed)).bit_generator.random_raw(3) for seed in seeds]
    np.testing.assert_array_equal(random_words(seeds, 3), expected)
