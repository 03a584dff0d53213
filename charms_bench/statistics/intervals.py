"""95 % intervals of metrics.

The steps of an episode depend on each other, but episodes are independent. So intervals come from
resampled episodes (a cluster bootstrap with percentiles, Davison & Hinkley 1997, section 3.8). For
events that happen at most once per episode, they come from Wilson (1927) and Garwood (1936).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from charms_bench.metrics.metric import Metric
from charms_bench.world.scene import Floats, Ints

CONFIDENCE = 0.95
RESAMPLES = 1000
WEIGHTS_LIMIT = 2**23
"""Most weights of resamples in memory at once, unless one resample has more."""
EPISODES_AT_ONCE = 2**16
"""Episodes that are added up at once."""

Bounds = tuple[float, float]
NO_BOUNDS: Bounds = (np.nan, np.nan)


@dataclass(frozen=True)
class Estimate:
    """A metric's value over some episodes; NaN where it is not defined."""

    value: float
    low: float
    high: float
    n: int
    """The size of the sample; `Metric.rests_on` says what it counts."""


def wilson(successes: int, trials: int) -> Bounds:
    """The interval of a share (Wilson 1927)."""
    from scipy import special

    share, z = successes / trials, float(special.ndtri((1 + CONFIDENCE) / 2))
    scale = 2 * (trials + z**2)
    centre = (2 * trials * share + z**2) / scale
    margin = z / scale * math.sqrt(4 * trials * share * (1 - share) + z**2)
    return (
        centre - margin if successes else 0.0,
        centre + margin if successes < trials else 1.0,
    )


def garwood(events: int) -> Bounds:
    """The exact interval of the mean of a Poisson distribution (Garwood 1936)."""
    from scipy import special  # scipy.stats takes half a second to import

    tail = (1 - CONFIDENCE) / 2
    low = special.gammaincinv(events, tail) if events else 0.0
    return float(low), float(special.gammainccinv(events + 1, tail))


def resample(rng: np.random.Generator, episodes: int, resamples: int = RESAMPLES) -> Floats:
    """How often each resample contains each episode, [resamples, episodes]."""
    drawn = rng.integers(max(episodes, 1), size=(resamples, episodes))
    drawn += np.arange(resamples)[:, None] * episodes
    counts = np.bincount(drawn.ravel(), minlength=resamples * episodes)
    return counts.reshape(resamples, episodes).astype(np.float64)


def resampled_totals(sums: Sequence[Floats | Ints], rng: np.random.Generator) -> Floats:
    """The totals [RESAMPLES, K] of all columns of some sums [E, k] over each resample."""
    episodes = len(sums[0])
    at_once = max(1, WEIGHTS_LIMIT // max(episodes, 1))
    blocks = []
    for start in range(0, RESAMPLES, at_once):
        weights = resample(rng, episodes, min(at_once, RESAMPLES - start))
        totals: Floats | float = 0.0
        for first in range(0, max(episodes, 1), EPISODES_AT_ONCE):
            part = slice(first, first + EPISODES_AT_ONCE)
            values = np.concatenate([each[part] for each in sums], axis=1, dtype=np.float64)
            totals = totals + weights[:, part] @ values
        blocks.append(totals)
    return np.concatenate(blocks)


def estimate(
    metrics: Sequence[Metric], sums: Sequence[Floats], rng: np.random.Generator
) -> list[Estimate]:
    """The value and the interval of each metric; all metrics share one set of resamples.

    `sums` are the metrics' sums [E, k], one row per episode (`metrics.sums_by_episode`).
    """
    resampled = resampled_totals(sums, rng)
    ends = np.cumsum([each.shape[1] for each in sums])[:-1]
    totals = np.split(resampled, ends, axis=1)
    return list(map(_estimate, metrics, sums, totals))


def _estimate(metric: Metric, sums: Floats, resampled: Floats) -> Estimate:
    totals = sums.sum(axis=0)
    n, events = round(totals[0]), round(totals[-1])
    value = float(metric.value(totals))
    if np.isnan(value):
        bounds = NO_BOUNDS
    elif metric.interval == "wilson":
        bounds = wilson(events, n)
    elif metric.interval == "garwood" or (metric.interval == "rate" and not events):
        low, high = garwood(events)
        bounds = low / float(totals[-2]), high / float(totals[-2])
    elif metric.interval == "share" and events in (0, n):
        counted = int((sums[:, 0] > 0).sum())
        bounds = wilson(counted if events else 0, counted)
    else:
        bounds = _percentiles(metric.value(resampled))
    return Estimate(value, bounds[0], bounds[1], n)


def _percentiles(values: Floats) -> Bounds:
    """The interval of resampled values; there is none if the values do not vary."""
    values = values[~np.isnan(values)]
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, [tail, 1 - tail]) if values.size else NO_BOUNDS
    return NO_BOUNDS if np.isclose(low, high, rtol=1e-9, atol=0) else (float(low), float(high))
