"""What is drawn is what NumPy's default generator draws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from charms_bench.foundation.generator import integers, random, seeded, uniform, word

SEEDS = st.integers(0, 2**64 - 1)


@settings(deadline=None)
@given(st.lists(SEEDS, min_size=1, max_size=4), st.integers(1, 200))
def test_words_are_those_of_numpys_generator(seeds: list[int], count: int) -> None:
    found = [[word(s) for _ in range(count)] for s in seeded(np.array(seeds, dtype=np.uint64))]
    assert found == [np.random.PCG64(seed).random_raw(count).tolist() for seed in seeds]


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**63])
def test_small_seeds_are_those_of_numpys_generator(seed: int) -> None:
    state = seeded(np.array([seed], dtype=np.uint64))[0]
    assert word(state) == np.random.default_rng(seed).bit_generator.random_raw()


@settings(deadline=None)
@given(SEEDS, st.lists(st.integers(0, 2), max_size=40), st.integers(1, 2**32 - 1))
def test_any_sequence_of_draws_is_numpys(seed: int, kinds: list[int], count: int) -> None:
    state = seeded(np.array([seed], dtype=np.uint64))[0]
    numpys = np.random.default_rng(seed)
    for kind in kinds:
        if kind == 0:
            assert integers(state, -3, count - 3) == numpys.integers(-3, count - 3)
        elif kind == 1:
            assert random(state) == numpys.random()
        else:
            assert uniform(state, -1.5, 7.0) == numpys.uniform(-1.5, 7.0)


def test_a_copied_state_continues_as_the_original() -> None:
    state = seeded(np.array([7], dtype=np.uint64))[0]
    integers(state, 0, 10)
    copy = state.copy()
    assert [integers(state, 0, 10) for _ in range(9)] == [integers(copy, 0, 10) for _ in range(9)]
