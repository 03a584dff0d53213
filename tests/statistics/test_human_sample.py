"""The sampling error of few recorded drivers, by simulation."""

import numpy as np
import pytest
from scipy import stats

from charms_bench.statistics.divergence import js_divergence, wasserstein
from charms_bench.statistics.human_sample import around, perfect_samples
from charms_bench.world.scene import Floats

BINS, WIDTH = 100, 0.5
MEAN, BETWEEN, WITHIN = 24.0, 4.0, 1.5
EDGES = WIDTH * np.arange(BINS + 1)
TRUTH = np.diff(stats.norm.cdf(EDGES, MEAN, np.hypot(BETWEEN, WITHIN)))


def drivers(count: int, values: int, rng: np.random.Generator) -> Floats:
    """[count, BINS] speeds of drivers, each around a speed of its own."""
    own = rng.normal(MEAN, BETWEEN, (count, 1))
    speeds = rng.normal(own, WITHIN, (count, values))
    return np.stack([np.histogram(each, EDGES)[0] for each in speeds]).astype(np.float64)


@pytest.mark.parametrize(("count", "values"), [(7, 1), (24, 80)])
def test_humans_are_as_near_to_their_distribution_as_a_perfect_simulator(
    count: int, values: int
) -> None:
    rng, repetitions = np.random.default_rng(1), 100
    covering = np.zeros(2)
    for _ in range(repetitions):
        units = drivers(count, values, rng)
        truth, samples = perfect_samples(units, rng)
        for k, distance in enumerate((js_divergence, lambda p, q: wasserstein(p, q, WIDTH))):
            low, high = np.quantile(distance(samples, truth), [0.025, 0.975])
            covering[k] += low <= distance(units.sum(axis=0), TRUTH) <= high
    # 100 of 95 %: standard deviation 2.2 %. Seven values tell little about their distribution.
    assert (covering / repetitions >= (0.80 if count < 10 else 0.89)).all()


def test_samples_have_as_many_values_as_were_recorded() -> None:
    rng = np.random.default_rng(2)
    units = drivers(10, 20, rng)
    truth, samples = perfect_samples(units, rng)
    assert (samples.sum(axis=1) == 200).all()
    assert truth.sum() == pytest.approx(1.0)
    assert samples.mean(axis=0) / 200 == pytest.approx(truth, abs=0.01)


def test_the_interval_of_a_distance_holds_what_so_many_humans_give_on_average() -> None:
    rng, repetitions, count = np.random.default_rng(3), 200, 24
    simulated = np.diff(stats.norm.cdf(EDGES, 27.0, 2.0))
    found, bounds = [], []
    for _ in range(repetitions):
        units = drivers(count, 80, rng)
        found.append(float(wasserstein(units.sum(axis=0), simulated, WIDTH)))
        weights = rng.multinomial(count, np.full(count, 1 / count), size=300)
        bounds.append(around(found[-1], wasserstein(weights @ units, simulated, WIDTH), count))
    low, high = np.array(bounds).T
    expected = np.mean(found)
    assert ((low <= expected) & (expected <= high)).mean() == pytest.approx(0.95, abs=0.045)


def test_a_single_unit_has_no_interval() -> None:
    assert np.isnan(around(1.0, np.array([1.0, 1.0]), 1)).all()
