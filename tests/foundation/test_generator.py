"""What is drawn is what NumPy's default generator draws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from charms_bench.foundation.generator import (
    choice,
    from_numpy,
    integers,
    normal,
    random,
    seeded,
    shuffle,
    to_numpy,
    two_integers,
    uniform,
    with_draws,
    word,
)

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
@given(
    SEEDS,
    st.lists(st.integers(0, 7), max_size=40),
    st.integers(1, 2**32 - 1),
    st.lists(st.floats(0.0, 9.0), min_size=1, max_size=6).filter(lambda some: sum(some) > 0.1),
)
def test_any_sequence_of_draws_is_numpys(
    seed: int, kinds: list[int], count: int, some: list[float]
) -> None:
    state, weights = seeded(np.array([seed], dtype=np.uint64))[0], np.array(some) / sum(some)
    rng = np.random.default_rng(seed)
    for kind in kinds:
        if kind == 0:
            assert integers(state, -3, count - 3) == rng.integers(-3, count - 3)
        elif kind == 1:
            assert random(state) == rng.random()
        elif kind == 2:
            assert uniform(state, -1.5, 7.0) == rng.uniform(-1.5, 7.0)
        elif kind == 3:
            assert normal(state, -1.5, 7.0) == rng.normal(-1.5, 7.0)
        elif kind == 4:
            assert choice(state, weights) == rng.choice(weights.size, p=weights)
        elif kind == 5:
            most = 2 + count % 9
            assert two_integers(state, most) == tuple(rng.choice(most, 2, replace=False))
        elif kind == 6:
            rows = np.arange(2 * (count % 40)).reshape(-1, 2)
            expected = rows.copy()
            rng.shuffle(expected)
            shuffle(state, rows)
            assert (rows == expected).all()
        else:
            assert integers(state, 0, len(some)) == rng.choice(len(some))
    assert (state == from_numpy(rng)).all()


@pytest.mark.parametrize("seed", range(5))
def test_many_normal_numbers_are_numpys_even_in_the_tails(seed: int) -> None:
    state, rng = seeded(np.array([seed], dtype=np.uint64))[0], np.random.default_rng(seed)
    found = np.array([normal(state, 0.0, 1.0) for _ in range(20_000)])
    assert (found == rng.standard_normal(20_000)).all()
    assert np.abs(found).max() > 3.66  # beyond the last strip, where the algorithm is another one


def test_numpys_generator_continues_from_a_state() -> None:
    state = seeded(np.array([7], dtype=np.uint64))[0]
    integers(state, 0, 10)  # leaves the half of a word
    rng = to_numpy(state)
    assert [rng.integers(0, 10) for _ in range(9)] == [integers(state, 0, 10) for _ in range(9)]


def test_a_copied_state_continues_as_the_original() -> None:
    state = seeded(np.array([7], dtype=np.uint64))[0]
    integers(state, 0, 10)
    copy = state.copy()
    assert [integers(state, 0, 10) for _ in range(9)] == [integers(copy, 0, 10) for _ in range(9)]


@settings(deadline=None)
@given(st.lists(st.floats(-6.0, 6.0), min_size=5, max_size=5), SEEDS, st.integers(1, 8))
def test_given_draws_come_first(draws: list[float], seed: int, bits: int) -> None:
    seeds = np.array([seed], dtype=np.uint64)
    (state,), (plain,) = with_draws(seeded(seeds), np.array([draws])), seeded(seeds)
    probability, count = ndtr(draws), 2**bits
    assert random(state) == pytest.approx(probability[0], abs=1e-12)
    assert normal(state, 3.0, 2.0) == 3.0 + 2.0 * draws[1]
    assert uniform(state, -5.0, 5.0) == pytest.approx(-5.0 + 10.0 * probability[2], abs=1e-10)
    assert abs(integers(state, 0, count) + 0.5 - count * probability[3]) <= 0.5 + 1e-6
    assert float(word(state)) == pytest.approx(probability[4] * 2.0**64, abs=2.0**30)
    assert [word(state) for _ in range(5)] == [word(plain) for _ in range(5)]
