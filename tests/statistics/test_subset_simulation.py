"""Subset simulation finds probabilities that are known, and its intervals hold them."""

import math

import numpy as np
import pytest
from known_probabilities import DIMENSION, PROBLEMS

from charms_bench.statistics.intervals import wilson
from charms_bench.statistics.subset_simulation import (
    Level,
    SubsetRun,
    interval,
    pilot_run,
    subset_simulation,
)


def run_of(probability: float, levels: int = 3) -> SubsetRun:
    proportions = (0.2,) * (levels - 1) + (probability / 0.2 ** (levels - 1),)
    return SubsetRun((0.0,) * levels, (0.5,) * (levels - 1), proportions, (1.0,) * levels, 1000)


def estimated(
    level: Level, samples: int, runs: int, seed: int, dimension: int = DIMENSION
) -> list[SubsetRun]:
    """The runs after their own pilot."""
    rng = np.random.default_rng([seed, 77])
    pilot = pilot_run(level, dimension, samples, rng)
    return subset_simulation(level, dimension, samples, runs, pilot, rng)


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_mean_of_many_small_runs_has_no_bias(name: str) -> None:
    # Thresholds from the points that are counted give 1.4 times the probability here.
    level, means = PROBLEMS[name](1e-4), []
    for seed in range(20):
        runs = estimated(level, 100, 100, seed)
        means.append(np.mean([run.probability for run in runs]) / 1e-4)
    error = np.std(means, ddof=1) / math.sqrt(20)
    assert np.mean(means) == pytest.approx(1.0, abs=4 * error)
    assert error < 0.05 if name != "jump" else error < 0.15


def test_the_interval_of_500_runs_of_100_samples_holds_the_probability_within() -> None:
    runs = estimated(PROBLEMS["linear"](5.55e-3), 100, 500, 0, dimension=20)
    low, high = interval(runs, 100)
    mean = np.mean([run.probability for run in runs])
    assert low < 5.55e-3 < high
    assert low == pytest.approx(mean**2 / high)
    assert high / low < 1.2


def test_a_common_event_is_a_plain_proportion_of_one_level() -> None:
    (run,) = estimated(PROBLEMS["linear"](0.3), 1000, 1, 0)
    assert run.thresholds == (0.0,)
    assert run.evaluations == 1000
    assert run.probability == pytest.approx(0.3, abs=0.05)


def test_the_pilot_keeps_a_fifth_at_each_level_and_simulates_the_rest() -> None:
    level = PROBLEMS["linear"](1e-4)
    pilot = pilot_run(level, DIMENSION, 200, np.random.default_rng(0))
    assert all(each in (0.2, 0.205, 0.21, 0.215, 0.22, 0.225) for each in pilot.shares[1:-1])
    assert pilot.shares[0] == 0.2
    assert list(pilot.thresholds) == sorted(pilot.thresholds, reverse=True)
    assert pilot.thresholds[-1] == 0.0
    assert len(pilot.sizes) == len(pilot.thresholds) - 1
    assert pilot.evaluations == 200 + 160 * (len(pilot.shares) - 1)


def test_runs_have_the_thresholds_of_the_pilot_and_other_proportions() -> None:
    level, rng = PROBLEMS["linear"](1e-4), np.random.default_rng(0)
    pilot = pilot_run(level, DIMENSION, 200, rng)
    one, other = subset_simulation(level, DIMENSION, 200, 2, pilot, rng)
    assert one.thresholds == other.thresholds == pilot.thresholds
    assert len({one.shares, other.shares, pilot.shares}) == 3
    assert one.evaluations == pilot.evaluations


def test_moves_are_accepted_near_the_target_proportion() -> None:
    (run,) = estimated(PROBLEMS["linear"](1e-6), 1000, 1, 0)
    assert run.acceptance[0] == 1.0
    assert all(0.25 < each < 0.6 for each in run.acceptance[1:])


def test_a_run_ends_at_a_level_that_no_point_reaches() -> None:
    pilot = SubsetRun((50.0, -50.0, 0.0), (0.5, 0.5), (1.0,) * 3, (1.0,) * 3, 0)
    level = PROBLEMS["linear"](0.3)
    (run,) = subset_simulation(level, DIMENSION, 100, 1, pilot, np.random.default_rng(0))
    assert run.shares == (1.0, 0.0)
    assert run.probability == 0.0
    assert run.evaluations == 180


def test_a_flat_level_that_never_reaches_the_event_gives_0() -> None:
    runs = estimated(lambda normal, seeds: np.full(len(normal), np.inf), 100, 5, 0)
    assert [run.probability for run in runs] == [0.0] * 5
    assert interval(runs, 100) == wilson(0, 500)


def test_a_level_that_is_flat_for_most_points_is_passed_without_bias() -> None:
    # 90 % of the points have the level 1; P(u < -3.719) = 1e-4.
    def level(normal: np.ndarray, seeds: np.ndarray) -> np.ndarray:
        return np.minimum((normal[:, 0] + 3.719016) / 2.437, 1.0)

    runs = estimated(level, 500, 100, 1, dimension=5)
    assert np.mean([run.probability for run in runs]) == pytest.approx(1e-4, rel=0.2)


def test_a_run_alone_depends_on_its_generator_and_its_pilot_only() -> None:
    level = PROBLEMS["linear"](1e-4)
    assert estimated(level, 100, 1, 8) == estimated(level, 100, 1, 8)


def test_the_interval_of_three_lognormal_runs_has_coxs_variance() -> None:
    # Logs of the estimates: m - 1, m, m + 1; their variance is 1, and Student's 97.5 % quantile
    # with 2 degrees of freedom is 4.302653. The squared relative error of the mean is 0.27, less
    # than Cox's variance, 1 / 3 + 1 / 4.
    values = [1e-4 * math.exp(each) for each in (-1.0, 0.0, 1.0)]
    factor = math.exp(4.302653 * math.sqrt(1 / 3 + 1 / 4))
    low, high = interval([run_of(each) for each in values], 1000)
    mean = sum(values) / 3
    assert low == pytest.approx(mean / factor, rel=1e-5)
    assert high == pytest.approx(mean * factor, rel=1e-5)


def test_the_interval_of_many_runs_with_an_outlier_has_the_variance_of_the_mean() -> None:
    # 99 estimates of 1e-4 and one of 1e-2: mean 1.99e-4, standard deviation 9.9e-4 (n - 1), and
    # Student's quantile with 99 degrees of freedom is 1.984217.
    low, high = interval([run_of(1e-4)] * 99 + [run_of(1e-2)], 1000)
    factor = math.exp(1.984217 * 9.9e-4 / 10 / 1.99e-4)
    assert low == pytest.approx(1.99e-4 / factor, rel=1e-5)
    assert high == pytest.approx(1.99e-4 * factor, rel=1e-5)


def test_runs_of_one_level_are_pooled() -> None:
    runs = [run_of(0.2, levels=1), run_of(0.3, levels=1)]
    assert interval(runs, 100) == pytest.approx(wilson(50, 200))


@pytest.mark.parametrize(("lost", "starts_at_0"), [(1, False), (2, True), (3, True)])
def test_the_interval_starts_at_0_if_half_of_the_runs_estimate_0(
    lost: int, starts_at_0: bool
) -> None:
    low, high = interval([run_of(0.0)] * lost + [run_of(2e-4)] * (4 - lost), 1000)
    assert (low == 0.0) is starts_at_0
    assert high > 2e-4


def test_there_is_no_interval_if_all_runs_estimate_0() -> None:
    assert np.isnan(interval([run_of(0.0), run_of(0.0)], 1000)).all()


COUNTS = (5, 10, 50, 100, 500)


def covered(name: str, probability: float, samples: int, repetitions: int) -> dict[int, float]:
    """The proportion of repetitions whose interval holds the probability, by the number of runs."""
    level, covering = PROBLEMS[name](probability), dict.fromkeys(COUNTS, 0)
    for repetition in range(repetitions):
        runs = estimated(level, samples, max(COUNTS), repetition, dimension=2)
        for count in COUNTS:
            low, high = interval(runs[:count], samples)
            covering[count] += low <= probability <= high
    return {count: each / repetitions for count, each in covering.items()}


def test_intervals_of_few_and_many_small_runs_hold_a_probability() -> None:
    # 60 repetitions of 95 %: 51 or fewer have a probability of 0.6 %.
    assert min(covered("linear", 5.55e-3, 100, 60).values()) > 51 / 60


@pytest.mark.slow
@pytest.mark.parametrize("samples", [100, 400])
@pytest.mark.parametrize(
    ("name", "probability"),
    [("linear", 1e-2), ("linear", 1e-4), ("linear", 1e-6), ("two_sided", 1e-4), ("jump", 1e-4)],
)
def test_intervals_hold_known_probabilities_in_93_percent(
    name: str, probability: float, samples: int
) -> None:
    # 400 repetitions of 95 %: standard deviation 1.1 %. tools/rare_coverage.py has 1,000.
    assert min(covered(name, probability, samples, 400).values()) >= 0.92
