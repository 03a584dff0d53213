"""Subset simulation finds probabilities that are known, and its intervals hold them."""

import math

import numpy as np
import pytest
from known_probabilities import DIMENSION, PROBLEMS

from charms_bench.statistics.intervals import wilson
from charms_bench.statistics.subset_simulation import (
    MOST_LEVELS,
    SubsetRun,
    interval,
    subset_simulation,
)


def run_of(probability: float, levels: int = 3) -> SubsetRun:
    shares = (0.1,) * (levels - 1) + (probability / 0.1 ** (levels - 1),)
    return SubsetRun((0.0,) * levels, shares, (1.0,) * levels, 1000)


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_mean_of_many_runs_is_near_the_known_probability(name: str) -> None:
    level, rng = PROBLEMS[name](1e-4), np.random.default_rng(3)
    found = [run.probability for run in subset_simulation(level, DIMENSION, 500, 60, rng)]
    # A run of 500 samples has a coefficient of variation near 0.5, and a bias near 0.1.
    assert np.mean(found) == pytest.approx(1e-4, rel=0.3)


def test_a_common_event_is_a_plain_share_of_one_level() -> None:
    level = PROBLEMS["linear"](0.3)
    (run,) = subset_simulation(level, DIMENSION, 1000, 1, np.random.default_rng(0))
    assert run.thresholds == (0.0,)
    assert run.evaluations == 1000
    assert run.probability == pytest.approx(0.3, abs=0.05)


def test_each_level_keeps_a_tenth_and_simulates_the_rest() -> None:
    level = PROBLEMS["linear"](1e-4)
    (run,) = subset_simulation(level, DIMENSION, 200, 1, np.random.default_rng(0))
    assert run.shares[:-1] == (0.1,) * (len(run.shares) - 1)
    assert list(run.thresholds) == sorted(run.thresholds, reverse=True)
    assert run.thresholds[-1] == 0.0
    assert run.evaluations == 200 + 180 * (len(run.shares) - 1)


def test_moves_are_accepted_near_the_target_share() -> None:
    level = PROBLEMS["linear"](1e-6)
    (run,) = subset_simulation(level, DIMENSION, 1000, 1, np.random.default_rng(0))
    assert run.acceptance[0] == 1.0
    assert all(0.3 < share < 0.55 for share in run.acceptance[1:])


def test_a_flat_level_that_never_reaches_the_event_gives_0() -> None:
    rng = np.random.default_rng(0)
    (run,) = subset_simulation(lambda normal, seeds: np.full(len(normal), np.inf), 3, 100, 1, rng)
    assert run.probability == 0.0
    assert len(run.shares) == MOST_LEVELS


def test_a_level_that_is_flat_for_most_points_is_passed_without_bias() -> None:
    # 60 % of the points have the level 1; P(u < -3.719) = 1e-4.
    def level(normal: np.ndarray, seeds: np.ndarray) -> np.ndarray:
        return np.minimum((normal[:, 0] + 3.719016) / 3.47, 1.0)

    found = subset_simulation(level, 5, 500, 60, np.random.default_rng(1))
    assert np.mean([run.probability for run in found]) == pytest.approx(1e-4, rel=0.3)


def test_a_run_alone_depends_on_its_generator_only() -> None:
    level = PROBLEMS["linear"](1e-4)
    one, other = (
        subset_simulation(level, DIMENSION, 100, 1, np.random.default_rng(8)) for _ in range(2)
    )
    assert one == other


def test_the_interval_of_three_runs_is_that_of_olsson() -> None:
    # Logs of the estimates: m - 0.5, m, m + 0.5 with m = log(1e-4); their variance is 0.25, and
    # Student's 97.5 % quantile with 2 degrees of freedom is 4.302653.
    runs = [run_of(1e-4 * math.exp(each)) for each in (-0.5, 0.0, 0.5)]
    margin = 4.302653 * math.sqrt(0.25 / 3 + 0.25**2 / 4)
    low, high = interval(runs, 1000)
    assert low == pytest.approx(1e-4 * math.exp(0.125 - margin), rel=1e-5)
    assert high == pytest.approx(1e-4 * math.exp(0.125 + margin), rel=1e-5)


def test_runs_of_one_level_are_pooled() -> None:
    runs = [run_of(0.2, levels=1), run_of(0.3, levels=1)]
    assert interval(runs, 100) == pytest.approx(wilson(50, 200))


def test_the_interval_starts_at_0_if_a_run_estimates_0() -> None:
    # Mean 2e-4, standard deviation 2e-4, three runs.
    low, high = interval([run_of(0.0), run_of(2e-4), run_of(4e-4)], 1000)
    assert low == 0.0
    assert high == pytest.approx(2e-4 + 4.302653 * 2e-4 / math.sqrt(3))


def test_there_is_no_interval_if_all_runs_estimate_0() -> None:
    assert np.isnan(interval([run_of(0.0), run_of(0.0)], 1000)).all()


def covered(name: str, probability: float, repetitions: int) -> float:
    """The share of repetitions, of 10 runs each, whose interval holds the probability."""
    level, held = PROBLEMS[name](probability), 0
    for repetition in range(repetitions):
        rng = np.random.default_rng([repetition, 77])
        low, high = interval(subset_simulation(level, DIMENSION, 1000, 10, rng), 1000)
        held += low <= probability <= high
    return held / repetitions


def test_intervals_hold_a_probability_of_one_in_a_thousand() -> None:
    # 40 repetitions of 95 %: fewer than 34 have a probability below 1 %.
    assert covered("linear", 1e-3, 40) >= 34 / 40


@pytest.mark.slow
@pytest.mark.parametrize("probability", [1e-3, 1e-5, 1e-7])
@pytest.mark.parametrize("name", ["linear", "parabolic", "two_sided"])
def test_intervals_hold_known_probabilities_in_92_to_98_percent(
    name: str, probability: float
) -> None:
    # 300 repetitions: standard deviation 1.3 %. tools/rare_coverage.py has 2,000.
    assert 0.915 <= covered(name, probability, 300) <= 0.985
