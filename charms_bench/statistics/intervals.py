"""95 % intervals of metrics.

The steps of an episode depend on each other, but episodes are independent. So the intervals of
means and standard deviations come from resampled episodes (a cluster bootstrap with percentiles,
Davison & Hinkley 1997, section 3.8). Proportions and rates have score intervals with an effective
sample size (Dean & Pagano 2015, Journal of Survey Statistics and Methodology 3), because resamples
of few events do not vary enough. For events that happen at most once per episode, intervals come
from Wilson (1927) and Garwood (1936).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from charms_bench.metrics.metric import Interval, Metric
from charms_bench.world.scene import Floats, Ints

CONFIDENCE = 0.95
RESAMPLES = 1000
WEIGHTS_LIMIT = 2**23
"""Most weights of resamples in memory at once, unless one resample has more."""
EPISODES_AT_ONCE = 2**16
"""Episodes that are added up at once."""
PRIOR_EPISODES = 0.5
"""Weight of full correlation in the design effect, in episodes with events. Chosen by the
simulation in `tests/statistics/test_interval_coverage.py`, with other seeds."""

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


def wilson(successes: float, trials: float, z: float | None = None) -> Bounds:
    """The score interval of a proportion (Wilson 1927), at 95 % without a normal quantile."""
    low, high = _score(successes, trials, z or _normal_quantile())
    return (low / trials if successes else 0.0, high / trials if successes < trials else 1.0)


def garwood(events: int) -> Bounds:
    """The exact interval of the mean of a Poisson distribution (Garwood 1936)."""
    from scipy import special  # scipy.stats takes half a second to import

    tail = (1 - CONFIDENCE) / 2
    low = special.gammaincinv(events, tail) if events else 0.0
    return float(low), float(special.gammainccinv(events + 1, tail))


def clustered(sums: Floats, kind: Interval) -> Bounds:
    """The score interval of a proportion or a rate of events that depend on each other.

    The events and trials are divided by the design effect: the variance of the ratio, linearised
    (Korn & Graubard 1998, Survey Methodology 24), over its variance if all events were independent.
    If few episodes have events, the design effect is uncertain. It is therefore averaged with the
    design effect of full correlation, whose weight is `PRIOR_EPISODES` episodes with events.
    The quantile is that of Student's t with 2 k + 2 degrees of freedom for k episodes with events.
    If fewer episodes have trials without events, k is their number.

    Args:
        sums: [E, k] with exposure and events in the last two columns. The first has the largest
            possible number of events; for a proportion, that is the exposure.
        kind: "proportion" or "rate".
    """
    from scipy import special

    first = -2 if kind == "proportion" else 0
    occasions, exposure, events = sums[:, [first, -2, -1]].T
    count, whole = float(events.sum()), float(exposure.sum())
    trials = whole if kind == "proportion" else math.inf
    episodes = int((occasions > 0).sum())
    fully_correlated = float((occasions**2).sum() / max(occasions.sum(), 1.0)) or 1.0
    informative = int((events > 0).sum())
    if kind == "proportion":
        informative = min(informative, int((events < occasions).sum()))
    if not informative or episodes < 2:
        effect, z = fully_correlated, _normal_quantile()
    else:
        squares = float(((events - count / whole * exposure) ** 2).sum())
        found = squares / (count * (1 - count / trials)) * episodes / (episodes - 1)
        prior = PRIOR_EPISODES * fully_correlated
        effect = (informative * found + prior) / (informative + PRIOR_EPISODES)
        z = float(special.stdtrit(2 * informative + 2, (1 + CONFIDENCE) / 2))
    if kind == "proportion":
        return wilson(count / effect, trials / effect, z)
    low, high = _score(count / effect, math.inf, z)
    return low * effect / whole if count else 0.0, high * effect / whole


def _score(count: float, trials: float, z: float) -> Bounds:
    """The score interval of an expected count; that of Poisson for an infinity of trials."""
    margin = z * math.sqrt(count * (1 - count / trials) + z**2 / 4)
    centre, scale = count + z**2 / 2, 1 + z**2 / trials
    return (centre - margin) / scale, (centre + margin) / scale


def _normal_quantile() -> float:
    from scipy import special

    return float(special.ndtri((1 + CONFIDENCE) / 2))


def resample(rng: np.random.Generator, episodes: int, resamples: int = RESAMPLES) -> Floats:
    """How often each resample contains each episode, [resamples, episodes]."""
    drawn = rng.integers(max(episodes, 1), size=(resamples, episodes))
    drawn += np.arange(resamples)[:, None] * episodes
    counts = np.bincount(drawn.ravel(), minlength=resamples * episodes)
    return counts.reshape(resamples, episodes).astype(np.float64)


def resampled_totals(sums: Sequence[Floats | Ints], source: int | np.random.Generator) -> Floats:
    """The totals [RESAMPLES, K] of all columns of some sums [E, k] over each resample.

    The source of the resamples is a seed, or a generator that is then used further.
    """
    totals = []
    for weights in _resamples(source, len(sums[0])):
        total: Floats | float = 0.0
        for first in range(0, max(weights.shape[1], 1), EPISODES_AT_ONCE):
            part = slice(first, first + EPISODES_AT_ONCE)
            values = np.concatenate([each[part] for each in sums], axis=1, dtype=np.float64)
            total = total + weights[:, part] @ values
        totals.append(total)
    return np.concatenate(totals)


def _resamples(source: int | np.random.Generator, episodes: int) -> Iterator[Floats]:
    """`RESAMPLES` resamples in blocks of at most `WEIGHTS_LIMIT` weights."""
    at_once = max(1, WEIGHTS_LIMIT // max(episodes, 1))
    if isinstance(source, int) and at_once >= RESAMPLES:
        yield _one_block(source, episodes)
        return
    rng = np.random.default_rng(source)
    for start in range(0, RESAMPLES, at_once):
        yield resample(rng, episodes, min(at_once, RESAMPLES - start))


@lru_cache(maxsize=1)
def _one_block(seed: int, episodes: int) -> Floats:
    """All resamples, kept because the cells of a suite share them."""
    weights = resample(np.random.default_rng(seed), episodes)
    weights.flags.writeable = False
    return weights


def estimate(metrics: Sequence[Metric], sums: Sequence[Floats], seed: int) -> list[Estimate]:
    """The value and the interval of each metric; all bootstraps share one set of resamples.

    `sums` are the metrics' sums [E, k], one row per episode (`metrics.sums_by_episode`).
    """
    places = [i for i, metric in enumerate(metrics) if metric.interval == "bootstrap"]
    resampled: dict[int, Floats] = {}
    if places:
        ends = np.cumsum([sums[i].shape[1] for i in places])[:-1]
        totals = resampled_totals([sums[i] for i in places], seed)
        resampled = dict(zip(places, np.split(totals, ends, axis=1), strict=True))
    return [
        _estimate(metric, each, resampled.get(i))
        for i, (metric, each) in enumerate(zip(metrics, sums, strict=True))
    ]


def _estimate(metric: Metric, sums: Floats, resampled: Floats | None) -> Estimate:
    totals = sums.sum(axis=0)
    value = float(metric.value(totals))
    if np.isnan(value):
        bounds = NO_BOUNDS
    elif resampled is None:
        bounds = of_events(metric.interval, sums)
    else:
        bounds = _percentiles(metric.value(resampled))
    return Estimate(value, bounds[0], bounds[1], round(totals[0]))


def of_events(kind: Interval, sums: Floats) -> Bounds:
    """The interval of a proportion or a rate of any kind but "bootstrap", from sums [E, k].

    Where episodes have several egos, an event can happen to each of them.
    """
    if kind in ("wilson", "garwood") and (sums[:, 0] > 1).any():
        return clustered(sums, "proportion" if kind == "wilson" else "rate")
    totals = sums.sum(axis=0)
    events = round(totals[-1])
    if kind == "wilson":
        return wilson(events, round(totals[0]))
    if kind == "garwood":
        low, high = garwood(events)
        return low / float(totals[-2]), high / float(totals[-2])
    return clustered(sums, kind)


def _percentiles(values: Floats) -> Bounds:
    """The interval of resampled values; undefined if they do not vary."""
    values = values[~np.isnan(values)]
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, [tail, 1 - tail]) if values.size else NO_BOUNDS
    return NO_BOUNDS if np.isclose(low, high, rtol=1e-9, atol=0) else (float(low), float(high))
