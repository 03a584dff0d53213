"""Divergences, against scipy and by hand."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.distance import jensenshannon

from charms_bench.statistics.divergence import js_divergence, kl_divergence, wasserstein

RNG = np.random.default_rng(0)
REFERENCE = RNG.integers(0, 9, 20).astype(np.float64)
OTHERS = RNG.integers(0, 9, (4, 20)).astype(np.float64)


def test_kl_is_scipys_entropy_of_counts_with_half_a_count_more() -> None:
    expected = [stats.entropy(REFERENCE + 0.5, other + 0.5) for other in OTHERS]
    np.testing.assert_allclose(kl_divergence(REFERENCE, OTHERS), expected, rtol=1e-12)


def test_kl_weighs_what_the_other_lacks_by_the_reference() -> None:
    # Proportions 7/8 and 1/8 against 1/2 and 1/2 (of 3 + 0.5 and 0 + 0.5, 3.5 and 3.5).
    found = kl_divergence(np.array([3.0, 0.0]), np.array([3.0, 3.0]))
    assert found == pytest.approx(7 / 8 * np.log(7 / 4) + 1 / 8 * np.log(1 / 4))


def test_js_is_the_square_of_scipys_distance_in_bits() -> None:
    expected = [jensenshannon(REFERENCE, other, base=2) ** 2 for other in OTHERS]
    np.testing.assert_allclose(js_divergence(REFERENCE, OTHERS), expected, rtol=1e-12)
    assert js_divergence(np.array([1.0, 0.0]), np.array([0.0, 5.0])) == pytest.approx(1.0)


def test_wasserstein_is_scipys_with_all_of_a_bin_at_one_place() -> None:
    places = 0.5 * np.arange(20) + 0.25
    expected = [stats.wasserstein_distance(places, places, REFERENCE, other) for other in OTHERS]
    np.testing.assert_allclose(wasserstein(REFERENCE, OTHERS, 0.5), expected, rtol=1e-12)


def test_nothing_counted_is_no_distance() -> None:
    none, some = np.zeros(4), np.ones(4)
    for distance in (kl_divergence, js_divergence, lambda p, q: wasserstein(p, q, 0.5)):
        assert np.isnan(distance(some, none))
        assert np.isnan(distance(none, some))
        assert distance(some, some) == pytest.approx(0.0, abs=1e-12)
