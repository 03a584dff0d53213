"""The measures of docs/mutants.md, against SciPy and by hand."""

import mutant_measures as mutants
import numpy as np
import pytest
from mutants import TOTAL, on_roads
from scipy import stats


def test_tau_is_kendalls() -> None:
    severity = np.random.default_rng(0).normal(size=(20, 5))
    expected = [stats.kendalltau(range(5), row).statistic for row in severity]
    np.testing.assert_allclose(mutants.kendalls_tau(severity), expected)
    # One exchanged pair of ten and one of six; a tie counts half of a pair.
    ladders = [[0, 1, 2, 3, 4], [0, 5, 6, 7]]
    of_both = mutants.taus(np.array([0.0, 1.0, 3.0, 2.0, 4.0, 2.0, 2.0, 3.0]), ladders)
    np.testing.assert_allclose(of_both, [8 / 10, 5 / 6, (8 / 10 + 5 / 6) / 2])


def test_as_many_episodes_are_needed_as_a_normal_distribution_says() -> None:
    # The mean difference of n episodes is above 0 in 95 % if it is 1.645 sd / root n.
    rng = np.random.default_rng(1)
    difference = rng.normal(size=2000)
    difference = 0.1 + (difference - difference.mean()) / difference.std()
    severity = np.column_stack([np.zeros(2000), difference, -difference])
    needed = mutants.episodes_until_ordered(severity, [[0, 1], [0, 2]], rng, resamples=1000)
    assert needed[0] == pytest.approx((1.645 / 0.1) ** 2, rel=0.2)
    assert needed[1] == needed[2] == np.inf


def test_a_fault_is_found_by_the_paired_difference() -> None:
    rng = np.random.default_rng(2)
    severity = rng.normal(size=(100, 1)) + rng.normal([0.0, 0.2, 0.4, -1.0], 1.0, size=(100, 4))
    expected = [stats.ttest_rel(severity[:, k], severity[:, 0]).statistic > 2.95 for k in (1, 2, 3)]
    assert mutants.found(severity).tolist() == expected
    assert stats.norm.isf(0.05 / 2 / 16) == pytest.approx(mutants.FOUND, abs=0.01)


def test_the_rate_counts_collisions_by_the_avoidable_proportion_of_those_searched() -> None:
    # 2 drivers with 3 collisions in 4 km; of two that were searched, one is avoidable.
    collided = np.array([[1.0, 1.0], [1.0, 0.0]])
    driven = mutants.Driven(collided, collided, np.ones((2, 2)), collided)
    searched = np.array([[2.0, 1.0], [0.0, 0.0]])
    rng = np.random.default_rng(3)
    assert mutants.per_1000_km(driven, searched, rng).value == pytest.approx(1000 * 3 / 4 / 2)
    none = driven._replace(collided=np.zeros((2, 2)))
    assert mutants.per_1000_km(none, np.zeros((2, 2)), rng).value == 0.0


def test_a_distance_that_is_not_enough_is_a_bound() -> None:
    resampled = np.array([100.0, 100.0, np.inf])
    assert mutants.distance(100.0, resampled, 0.5, 1200) == "50 [50, above 600]"


def test_likeness_is_that_of_the_traffic_models() -> None:
    rows = "| A | ego | 1 | 2 | 3 | 0.50 [0.1, 0.9] |\n| A | traffic | 1 | 2 | 3 | -1 [-2, 0] |\n"
    assert TOTAL.findall(rows) == [("A", "-1 [-2, 0]")]


def test_on_all_roads_together_an_episode_is_the_mean_of_those_with_its_seed() -> None:
    hard, easy = np.tile([1.0, 3.0], (40, 1)), np.tile([1.0, 1.0], (40, 1))
    hard, easy = (each + np.arange(40)[:, None] / 400 for each in (hard, easy))
    never, km = np.zeros((40, 2), np.bool_), np.full((40, 2), 0.5)
    driven = {
        (road, "IDM"): mutants.Driven(severity, severity, km, never)
        for road, severity in (("merge", hard), ("exit", easy))
    }
    rows = on_roads(driven, {"Delay": [0, 1]}).records()
    assert [row["road"] for row in rows] == ["merge", "exit", "all"]
    assert [row["delay"] for row in rows] == ["1", "none", "1"]
    # The order is found in the fewest episodes that are tried, 10, of 0.5 km, and of 1 km together.
    assert [row["km until τ ≥ 0.9"] for row in rows] == [
        "5 [5, 5]",
        "above 20 [above 20, above 20]",
        "10 [10, 10]",
    ]
