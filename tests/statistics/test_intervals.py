"""Intervals, against published figures and scipy."""

import numpy as np
import pytest
from made_up import metric_of
from scipy import stats

from charms_bench.metrics.metric import Interval, standard_deviation
from charms_bench.statistics import intervals
from charms_bench.statistics.intervals import (
    RESAMPLES,
    estimate,
    garwood,
    resample,
    resampled_totals,
    wilson,
)


def interval_of(sums: list[list[float]], interval: Interval) -> tuple[float, float]:
    array = np.array(sums, dtype=np.float64)
    (result,) = estimate([metric_of(interval)], [array], 0)
    return result.low, result.high


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # Newcombe 1998, Statistics in Medicine 17, table I, method 3.
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilsons_interval_is_that_of_newcombes_table(
    successes: int, trials: int, low: float, high: float
) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize(
    ("events", "low", "high"),
    # As in Garwood 1936, Biometrika 28.
    [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.390)],
)
def test_garwoods_interval_is_the_tabulated_one(events: int, low: float, high: float) -> None:
    assert garwood(events) == pytest.approx((low, high), rel=1e-3)


def test_each_resample_has_as_many_episodes_as_there_are() -> None:
    weights = resample(np.random.default_rng(1), 7, resamples=2000)
    assert weights.shape == (2000, 7)
    assert (weights.sum(axis=1) == 7).all()
    assert weights.mean() == 1.0
    # Multinomial: the variance of a count is 7 (1/7) (6/7).
    assert weights.var() == pytest.approx(6 / 7, abs=0.05)


def test_the_bootstrap_interval_of_a_ratio_is_scipys() -> None:
    rng = np.random.default_rng(2)
    steps = rng.integers(5, 60, size=200).astype(float)
    total = steps * rng.normal(25.0, 2.0, size=200)
    (ours,) = estimate([metric_of()], [np.stack([steps, total], axis=1)], 2)
    theirs = stats.bootstrap(
        (steps, total),
        lambda n, s, axis=-1: s.sum(axis=axis) / n.sum(axis=axis),
        paired=True,
        method="percentile",
        n_resamples=5000,
        rng=rng,
    ).confidence_interval
    width = theirs.high - theirs.low
    assert ours.value == pytest.approx(total.sum() / steps.sum())
    assert ours.n == steps.sum()
    assert (ours.low, ours.high) == pytest.approx(tuple(theirs), abs=0.1 * width)


def test_the_bootstrap_interval_of_a_standard_deviation_is_scipys() -> None:
    rng = np.random.default_rng(3)
    sample = rng.normal(5.0, 2.0, size=300)
    sums = np.stack([np.ones(300), sample, sample**2], axis=1)
    (ours,) = estimate([metric_of(value=standard_deviation)], [sums], 3)
    theirs = stats.bootstrap(
        (sample,), np.std, method="percentile", n_resamples=5000, rng=rng
    ).confidence_interval
    assert ours.value == pytest.approx(sample.std())
    assert (ours.low, ours.high) == pytest.approx(
        tuple(theirs), abs=0.1 * (theirs.high - theirs.low)
    )


def test_about_95_of_100_intervals_hold_the_truth() -> None:
    rng = np.random.default_rng(4)
    covering = 0
    for seed in range(200):
        steps = np.full(80, 60.0)
        # Steps of an episode depend on one another: the mean of each is drawn.
        total = steps * rng.normal(25.0, 2.0, size=80)
        (result,) = estimate([metric_of()], [np.stack([steps, total], axis=1)], seed)
        covering += result.low <= 25.0 <= result.high
    assert 0.90 <= covering / 200 <= 0.985


def test_the_same_seed_gives_the_same_interval_whatever_is_beside_it() -> None:
    sums = np.random.default_rng(5).random((40, 2))
    (alone,) = estimate([metric_of()], [sums], 6)
    pair = estimate([metric_of()] * 2, [sums, sums + 1], 6)
    assert pair[0].low == pytest.approx(alone.low, rel=1e-12)
    assert pair[0].high == pytest.approx(alone.high, rel=1e-12)


def test_a_proportion_that_never_happens_is_bounded_as_if_steps_of_an_episode_were_alike() -> None:
    # 60 and 30 alike steps weigh as much as 90² / (60² + 30²) = 1.8 independent ones.
    never = [[60, 0], [30, 0], [0, 0]]
    always = [[60, 60], [30, 30]]
    assert interval_of(never, "proportion") == pytest.approx(wilson(0, 1.8))
    assert interval_of(always, "proportion") == pytest.approx(wilson(1.8, 1.8))


def test_a_rate_that_never_happens_is_bounded_as_if_events_of_an_episode_were_alike() -> None:
    # z² = 3.8415 events of independent vehicles, 20 alike vehicles each, in 2 km.
    never = [[20, 0.5, 0], [20, 1.5, 0]]
    assert interval_of(never, "rate") == pytest.approx((0.0, 3.8415 * 20 / 2), rel=1e-4)
    one_each = [[1, 0.5, 0], [1, 1.5, 0]]
    assert interval_of(one_each, "garwood") == pytest.approx((0.0, 3.689 / 2), rel=1e-3)


def test_a_rate_without_any_occasion_has_the_interval_of_independent_events() -> None:
    assert interval_of([[0, 1.0, 0]] * 2, "rate") == pytest.approx((0.0, 3.8415 / 2), rel=1e-4)


def test_episodes_without_occasions_do_not_change_the_interval_of_a_proportion() -> None:
    sums = [[60, 3], [50, 0], [60, 10]]
    assert interval_of([*sums, [0, 0]], "proportion") == interval_of(sums, "proportion")


def test_a_single_event_does_not_make_a_proportion_certain() -> None:
    sums = [[60, 0]] * 599 + [[60, 1]]
    low, high = interval_of(sums, "proportion")
    # Not much less than if it never happened, 3.8415 / 603.8.
    assert 0 < low < 1 / 36_000
    assert 0.5 * 0.00636 < high < 0.00636
    low, high = interval_of([[60, 60 - x] for _, x in sums], "proportion")
    assert 1 - 0.00636 < low < 1 - 0.5 * 0.00636
    assert 1 - 1 / 36_000 < high < 1


def test_events_of_many_episodes_have_korn_and_graubards_effective_sample_size() -> None:
    rng = np.random.default_rng(7)
    proportions = rng.binomial(50, rng.beta(2.0, 8.0, 2000)) / 50
    sums = np.stack([np.full(2000, 50), 50 * proportions], axis=1)
    size = proportions.mean() * (1 - proportions.mean()) / (proportions.var(ddof=1) / 2000)
    expected = stats.binomtest(round(size * proportions.mean()), round(size)).proportion_ci(
        method="wilson"
    )
    assert interval_of(sums.tolist(), "proportion") == pytest.approx(tuple(expected), rel=2e-3)


def test_a_rate_of_independent_events_has_almost_garwoods_interval() -> None:
    rng = np.random.default_rng(8)
    events = rng.poisson(0.5, 2000)
    sums = np.stack([np.full(2000, 20), np.full(2000, 0.5), events], axis=1)
    low, high = np.array(garwood(int(events.sum()))) / 1000
    assert interval_of(sums.tolist(), "rate") == pytest.approx((low, high), rel=0.01)


def test_steps_that_are_all_alike_count_as_one_per_episode() -> None:
    sums = [[60, 60]] * 81 + [[60, 0]] * 182
    low, high = interval_of(sums, "proportion")
    expected = wilson(81, 263)
    assert (low, high) == pytest.approx(expected, rel=0.01)


def test_the_interval_of_a_single_episode_treats_its_steps_as_one() -> None:
    assert interval_of([[60, 30]], "proportion") == pytest.approx(wilson(0.5, 1))


def test_a_proportion_of_episodes_has_wilsons_interval() -> None:
    sums = [[1, 1]] * 81 + [[1, 0]] * 182
    assert interval_of(sums, "wilson") == wilson(81, 263)


@pytest.mark.parametrize("sums", [[[60, 1500]], [[60, 1500]] * 5, [[60, 0]] * 5])
def test_resamples_that_do_not_vary_give_no_interval(sums: list[list[float]]) -> None:
    assert np.isnan(interval_of(sums, "bootstrap")).all()


def test_resamples_without_a_value_are_left_out() -> None:
    # One resample in 16 misses both episodes with a leader.
    low, high = interval_of([[10, 200], [10, 300], [0, 0], [0, 0]], "bootstrap")
    assert (low, high) == (20.0, 30.0)


@pytest.mark.parametrize("interval", ["bootstrap", "proportion", "rate", "garwood", "wilson"])
def test_what_is_not_defined_has_no_interval(interval: Interval) -> None:
    assert np.isnan(interval_of([[0, 0], [0, 0]], interval)).all()


def test_no_episodes_give_no_numbers() -> None:
    (result,) = estimate([metric_of()], [np.empty((0, 2))], 0)
    assert np.isnan([result.value, result.low, result.high]).all()
    assert result.n == 0
    assert resample(np.random.default_rng(0), 0).shape == (RESAMPLES, 0)


def test_resamples_in_blocks_are_the_same_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    sums = [np.arange(14.0).reshape(7, 2), np.ones((7, 1))]
    whole = resample(np.random.default_rng(1), 7) @ np.concatenate(sums, axis=1)
    monkeypatch.setattr(intervals, "WEIGHTS_LIMIT", 20)
    monkeypatch.setattr(intervals, "EPISODES_AT_ONCE", 3)
    np.testing.assert_array_equal(resampled_totals(sums, 1), whole)
