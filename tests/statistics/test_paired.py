"""Paired differences, against published figures and scipy."""

import numpy as np
import pytest
from made_up import metric_of
from scipy import stats

from charms_bench.metrics.metric import Interval, ratio, standard_deviation
from charms_bench.statistics.intervals import resample, wilson
from charms_bench.statistics.paired import (
    Difference,
    combined,
    differences,
    holm,
    mcnemar,
    tango,
)


def difference(
    first: np.ndarray, second: np.ndarray, interval: Interval = "bootstrap", value=ratio
) -> Difference:
    weights = resample(np.random.default_rng(0), len(first))
    (found,) = differences([metric_of(interval, value)], [first], [second], weights)
    return found


def outcomes(both: int, only_first: int, only_second: int, neither: int) -> list[np.ndarray]:
    counts = (both, only_first, only_second, neither)
    first, second = np.repeat([1, 1, 0, 0], counts), np.repeat([1, 0, 1, 0], counts)
    return [np.stack([np.ones(sum(counts)), each], axis=1) for each in (first, second)]


def means(values: np.ndarray) -> np.ndarray:
    return np.stack([np.ones(len(values)), values], axis=1)


@pytest.mark.parametrize(
    ("only_first", "only_second", "pairs", "low", "high"),
    [
        # Complete response before and after consolidation therapy and airway
        # hyper-responsiveness, Fagerland, Lydersen & Laake 2014, Statistics in Medicine 33.
        (6, 16, 161, -0.1240, -0.0054),
        (1, 7, 21, -0.517, -0.026),
        # Without unlike pairs the ends solve n d² = z² (1 - d): those of Wilson for 0 of 20.
        (0, 0, 20, -0.1611, 0.1611),
    ],
)
def test_the_score_interval_is_the_published_one(
    only_first: int, only_second: int, pairs: int, low: float, high: float
) -> None:
    digits = 5e-4 if abs(round(low, 3) - low) < 1e-9 else 5e-5
    assert tango(only_first, only_second, pairs) == pytest.approx((low, high), abs=digits)
    assert tango(only_second, only_first, pairs) == pytest.approx((-high, -low), abs=digits)


def test_the_score_interval_stays_within_1() -> None:
    # All pairs unlike: (b - n d)² = z² n (1 - d²) at d = (n - z²) / (n + z²), n = 5.
    assert tango(0, 5, 5) == pytest.approx((-1.0, -(5 - 3.8415) / (5 + 3.8415)), abs=1e-4)


def test_mcnemars_p_is_the_published_one() -> None:
    assert mcnemar(6, 16) == pytest.approx(0.052479, abs=1e-6)  # Fagerland et al. 2014
    assert mcnemar(0, 0) == 1.0


def test_proportions_of_episodes_are_compared_by_mcnemar_and_tango() -> None:
    found = difference(*outcomes(59, 6, 16, 80), interval="wilson")
    assert found.value == pytest.approx(-10 / 161)
    assert (found.low, found.high) == pytest.approx((-0.1240, -0.0054), abs=5e-5)
    assert found.p == pytest.approx(0.052479, abs=1e-6)
    # By hand: 23 / 163 less (10 / 163)², over 163; its root times 1.9600 + 0.8416.
    assert found.detectable == pytest.approx(2.8016 * 0.029027, rel=1e-4)


def test_a_proportion_of_collisions_is_not_one_of_episodes() -> None:
    """105 of 106 collisions against 15 of 15, in 200 episodes."""
    first, second = np.zeros((200, 2)), np.zeros((200, 2))
    first[:106, 0], first[:105, 1] = 1.0, 1.0
    second[:15] = 1.0
    found = difference(first, second, interval="wilson")
    assert found.value == pytest.approx(105 / 106 - 1.0)
    assert found.low < found.value < found.high
    assert found.p > 0.05


@pytest.mark.parametrize("nothing", [0, 1])
def test_a_proportion_of_nothing_is_not_compared(nothing: int) -> None:
    both = [means(np.ones(40)), means(np.ones(40))]
    both[nothing] = np.zeros((40, 2))
    found = difference(*both, interval="wilson")
    assert np.isnan([found.value, found.low, found.high, found.detectable]).all()
    assert found.p == 1.0


def test_proportions_that_never_differ_could_still_have_shown_only_so_much() -> None:
    found = difference(*outcomes(0, 0, 0, 98), interval="wilson")
    assert (found.value, found.p) == (0.0, 1.0)
    assert found.detectable == pytest.approx(2.8016 * 0.01, rel=1e-4)


def test_the_difference_of_means_is_the_paired_t_test() -> None:
    # Normal differences: their t has n - 1 degrees of freedom, which the resamples have to find.
    rng = np.random.default_rng(1)
    hard = rng.normal(0.0, 5.0, 400)
    first, second = hard + rng.normal(25.2, 1.0, 400), hard + rng.normal(25.0, 1.0, 400)
    found = difference(means(first), means(second))
    theirs = stats.ttest_rel(first, second)
    interval = theirs.confidence_interval()
    width = interval.high - interval.low
    assert found.value == pytest.approx((first - second).mean())
    assert (found.low, found.high) == pytest.approx(tuple(interval), abs=0.03 * width)
    assert found.p == pytest.approx(theirs.pvalue, rel=0.2)


@pytest.mark.parametrize("value", [ratio, standard_deviation])
def test_the_interval_of_a_function_of_sums_is_about_scipys(value) -> None:
    rng = np.random.default_rng(2)

    def sample() -> np.ndarray:
        count = rng.integers(20, 60, 300).astype(float)
        total = count * rng.normal(25.0, 2.0, 300)
        return np.stack([count, total, total**2 / count + count * rng.random(300)], axis=1)

    first, second = sample(), sample()

    def statistic(picked: np.ndarray, axis: int) -> np.ndarray:
        indices = np.moveaxis(picked.astype(int), axis, -1)
        return value(first[indices].sum(axis=-2)) - value(second[indices].sum(axis=-2))

    theirs = stats.bootstrap(
        (np.arange(300),), statistic, method="percentile", n_resamples=3000, rng=rng
    ).confidence_interval
    found = difference(first, second, value=value)
    assert (found.low, found.high) == pytest.approx(
        tuple(theirs), abs=0.1 * (theirs.high - theirs.low)
    )


def test_the_detectable_difference_has_a_power_of_80_percent() -> None:
    # Differences have a standard deviation of 1: 2.8016 / sqrt(200), and a little for Student.
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(2, 200)) / np.sqrt(2)
    found = difference(means(first), means(second))
    assert found.detectable == pytest.approx(2.8016 / np.sqrt(200), rel=0.15)


def test_agents_that_do_the_same_are_not_apart() -> None:
    same = means(np.random.default_rng(4).random(50))
    found = difference(same, same)
    assert (found.value, found.p) == (0.0, 1.0)
    assert np.isnan([found.low, found.high, found.detectable]).all()


def test_a_difference_that_never_varies_is_as_sure_as_the_episodes_are_many() -> None:
    # All of m signs alike, in one direction or the other: 2 / 2**m.
    found = difference(means(np.full(10, 26.0)), means(np.full(10, 25.0)))
    assert (found.value, found.low, found.high) == (1.0, 1.0, 1.0)
    assert found.p == 2 / 2**10
    assert difference(means(np.array([26.0])), means(np.array([25.0]))).p == 1.0


def test_what_a_single_episode_did_has_no_interval() -> None:
    first = np.zeros(100)
    first[7] = 1.0
    found = difference(means(first), means(np.zeros(100)))
    assert found.value == pytest.approx(0.01)
    assert np.isnan([found.low, found.high]).all()
    assert found.p == 1.0


def steps_with(*events: int) -> np.ndarray:
    """100 episodes of 60 steps, the first of which have these events."""
    sums = np.zeros((100, 2))
    sums[:, 0] = 60
    sums[: len(events), 1] = events
    return sums


@pytest.mark.parametrize("events", [(), (1,), (5, 60)])
def test_a_proportion_of_few_events_has_an_interval_around_no_difference(
    events: tuple[int, ...],
) -> None:
    found = difference(steps_with(*events), steps_with(), "proportion")
    assert found.low < 0 < found.high
    assert found.low < found.value < found.high


def test_a_rate_that_neither_agent_has_is_bounded_on_both_sides() -> None:
    # Garwood 1936: at most 3.689 events in the 100 km of each.
    none = np.stack([np.ones(100), np.ones(100), np.zeros(100)], axis=1)
    found = difference(none, none.copy(), "garwood")
    assert (found.low, found.high) == pytest.approx((-0.03689, 0.03689), rel=1e-3)


def test_agents_that_share_all_events_are_not_apart() -> None:
    found = difference(steps_with(5, 60), steps_with(5, 60), "proportion")
    assert np.isnan([found.low, found.high]).all()


def test_combined_intervals_are_newcombes_of_independent_proportions() -> None:
    # Newcombe 1998, Statistics in Medicine 17, 873-890, table II (a), method 10: 56/70 - 48/80.
    found = combined([56 / 70, 48 / 80], [wilson(56, 70), wilson(48, 80)])
    assert found == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_what_is_0_in_all_episodes_has_no_spread_to_differ_in() -> None:
    none = np.stack([np.full(40, 60.0), np.zeros(40), np.zeros(40)], axis=1)
    found = difference(none, none.copy(), value=standard_deviation)
    assert (found.value, found.p) == (0.0, 1.0)


def test_what_only_one_agent_has_is_not_compared() -> None:
    found = difference(np.zeros((30, 2)), means(np.arange(30.0)))
    assert np.isnan([found.value, found.low, found.high, found.detectable]).all()
    assert found.p == 1.0


@pytest.mark.parametrize("interval", ["bootstrap", "wilson"])
def test_no_episodes_show_nothing(interval: Interval) -> None:
    found = difference(np.empty((0, 2)), np.empty((0, 2)), interval)
    assert np.isnan(found.value)
    assert found.p == 1.0


def test_holm_corrects_as_in_his_paper() -> None:
    # Sorted 0.01, 0.02, 0.03, 0.04 times 4, 3, 2, 1: 0.04, 0.06, 0.06, 0.04 -> 0.06.
    corrected = holm(np.array([0.03, 0.01, 0.04, 0.02]))
    np.testing.assert_allclose(corrected, [0.06, 0.04, 0.06, 0.06])
    np.testing.assert_allclose(holm(np.array([0.9, 0.8])), [1.0, 1.0])
