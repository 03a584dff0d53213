"""Compares two agents over the same episodes: differences, intervals and p-values.

A seed gives both agents the same episode, so episodes are pairs, and the difficulty of an episode
does not blur the difference. Proportions of all episodes use McNemar's exact test (McNemar 1947)
and the score interval of Tango (1998, Statistics in Medicine 17). Every other metric, such as a
proportion of the collisions, is a function of sums over episodes. The standard error of its
difference follows from the sums by linearisation. Resampled episodes give the tails of the
difference divided by its standard error (the symmetric bootstrap-t, Hall 1988, Annals of
Statistics 16). The tails are described by Student's t with the degrees of freedom at which its
95 % point equals that of the resamples; the interval and the p-value both use it. If too few
episodes differ for that, the interval of a proportion or a rate follows from those of the two
agents (Zou & Donner 2008, Statistics in Medicine 27).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, stats

from charms_bench.metrics.metric import Metric
from charms_bench.statistics.intervals import CONFIDENCE, NO_BOUNDS, Bounds, of_events
from charms_bench.world.scene import Floats

POWER = 0.8
UPPER = (1 + CONFIDENCE) / 2
FEWEST_DEGREES = 1.0
"""If the tails are heavier than with these degrees of freedom, no interval is given."""
MANY_DEGREES = 1e6
STEP = 1e-6
"""Relative step of numerical gradients: about the cube root of a double's precision."""


@dataclass(frozen=True)
class Difference:
    """The first agent's value minus the second's; NaN where it is not defined."""

    value: float
    low: float
    high: float
    p: float
    """Two-sided, not corrected for the number of tests; 1 if there is nothing to test."""
    detectable: float
    """The smallest true difference that this many episodes detect in 80 % of cases at a two-sided
    level of 5 %: the standard error times the sum of the 97.5 % and 80 % points."""


def differences(
    metrics: Sequence[Metric], first: Sequence[Floats], second: Sequence[Floats], weights: Floats
) -> list[Difference]:
    """The difference of two agents in each metric.

    `first` and `second` are the agents' sums [E, k], one row per episode, of the same episodes
    (`metrics.sums_by_episode`); `weights` [R, E] are resampled episodes (`intervals.resample`).
    """
    return [
        _difference(metric, ours, theirs, weights)
        for metric, ours, theirs in zip(metrics, first, second, strict=True)
    ]


def _difference(metric: Metric, ours: Floats, theirs: Floats, weights: Floats) -> Difference:
    if metric.interval == "wilson" and all((each[:, 0] == 1).all() for each in (ours, theirs)):
        return _of_proportions(ours, theirs)
    found = _of_sums(metric.value, ours, theirs, weights)
    has_interval = np.isnan(found.value) or not np.isnan(found.low)
    # Agents that never differ although something happens are the same agent.
    same = ours[:, -1].any() and np.array_equal(ours, theirs)
    if metric.interval == "bootstrap" or has_interval or same:
        return found
    bounds = [of_events(metric.interval, each) for each in (ours, theirs)]
    values = [float(metric.value(each.sum(axis=0))) for each in (ours, theirs)]
    low, high = combined(values, bounds)
    return replace(found, low=low, high=high)


def combined(values: Sequence[float], bounds: Sequence[Bounds]) -> Bounds:
    """The interval of a difference of two values, from theirs (Zou & Donner 2008).

    It is too wide if the values are positively correlated.
    """
    (first, second), ((low, high), (other_low, other_high)) = values, bounds
    below = np.hypot(first - low, other_high - second)
    above = np.hypot(high - first, second - other_low)
    return float(first - second - below), float(first - second + above)


def _of_proportions(ours: Floats, theirs: Floats) -> Difference:
    n, events = len(ours), (ours[:, -1] > 0, theirs[:, -1] > 0)
    only_first = int((events[0] & ~events[1]).sum())
    only_second = int((events[1] & ~events[0]).sum())
    if not n:
        return Difference(np.nan, *NO_BOUNDS, 1.0, np.nan)
    # Half an episode is added to each cell of the table (Agresti & Min 2005, Statistics in Medicine
    # 24). Otherwise, the smallest difference would seem detectable if the agents never differ.
    unlike = (only_first + only_second + 1) / (n + 2)
    error = np.sqrt((unlike - ((only_first - only_second) / (n + 2)) ** 2) / (n + 2))
    return Difference(
        (only_first - only_second) / n,
        *tango(only_first, only_second, n),
        mcnemar(only_first, only_second),
        float((stats.norm.ppf(UPPER) + stats.norm.ppf(POWER)) * error),
    )


def mcnemar(only_first: int, only_second: int) -> float:
    """The exact p-value of the hypothesis that both kinds of unlike pairs are equally likely."""
    unlike = only_first + only_second
    return float(stats.binomtest(only_first, unlike).pvalue) if unlike else 1.0


def tango(only_first: int, only_second: int, pairs: int) -> Bounds:
    """The score interval of a paired difference of proportions (Tango 1998)."""

    def excess(difference: float, side: float) -> float:
        """The score minus the 95 % point; eqs. 2 and 3."""
        b = (2 * pairs - only_first + only_second) * difference - only_first - only_second
        c = -only_second * difference * (1 - difference)
        proportion = (np.sqrt(max(b * b - 8 * pairs * c, 0.0)) - b) / (4 * pairs)
        variance = max(pairs * (2 * proportion + difference * (1 - difference)), 0.0)
        score = only_first - only_second - pairs * difference
        return float(score - side * stats.norm.ppf(UPPER) * np.sqrt(variance))

    value = (only_first - only_second) / pairs
    # At the value itself, the score is 0 for all data, and the variance may be 0 too.
    low = optimize.brentq(excess, -1.0, value - 1e-12, (1.0,)) if value > -1 else -1.0
    high = optimize.brentq(excess, value + 1e-12, 1.0, (-1.0,)) if value < 1 else 1.0
    return float(low), float(high)


def _of_sums(
    value: Callable[[Floats], Floats], ours: Floats, theirs: Floats, weights: Floats
) -> Difference:
    n, sums = len(ours), np.concatenate([ours, theirs], axis=1)

    def difference(totals: Floats) -> Floats:
        return value(totals[..., : ours.shape[1]]) - value(totals[..., ours.shape[1] :])

    totals = sums.sum(axis=0)
    found = float(difference(totals))
    unlike = int((ours != theirs).any(axis=1).sum())
    if np.isnan(found):
        return Difference(np.nan, *NO_BOUNDS, 1.0, np.nan)
    # As for McNemar: at best, all episodes that differ do so in the same direction.
    least = 2.0 ** (1 - unlike) if unlike else 1.0
    products = (sums[:, :, None] * sums[:, None, :]).reshape(n, -1)
    error = float(_error(difference, totals, products.sum(axis=0), n))
    if error <= 1e-9 * max(abs(found), 1e-9):
        constant = (found, found) if found and unlike > 1 else NO_BOUNDS
        return Difference(found, *constant, least if found else 1.0, np.nan)
    resampled = weights @ sums
    errors = _error(difference, resampled, weights @ products, n)
    degrees = _degrees(difference(resampled) - found, errors)
    if degrees < FEWEST_DEGREES:
        return Difference(found, *NO_BOUNDS, 1.0, np.nan)
    margin = stats.t.ppf(UPPER, degrees) * error
    return Difference(
        found,
        float(found - margin),
        float(found + margin),
        max(float(2 * stats.t.sf(abs(found) / error, degrees)), least),
        float(margin + stats.t.ppf(POWER, degrees) * error),
    )


def _error(
    difference: Callable[[Floats], Floats], totals: Floats, products: Floats, episodes: int
) -> Floats:
    """The standard error of a function of totals [..., k], from the totals of products [..., k²].

    An episode changes the function by its gradient times the episode's sums. The variance of the
    function is the variance of these changes times the number of episodes.
    """
    gradient = np.empty_like(totals)
    for j in range(totals.shape[-1]):
        step = np.zeros_like(totals)
        step[..., j] = STEP * np.where(totals[..., j] == 0, 1.0, np.abs(totals[..., j]))
        # Where nothing was counted, a step back would lead to negative totals.
        back = np.where(totals == 0, 0.0, step)
        rise = difference(totals + step) - difference(totals - back)
        gradient[..., j] = rise / (step + back)[..., j]
    second_moments = products.reshape(*totals.shape, -1)
    squares = np.einsum("...i,...ij,...j->...", gradient, second_moments, gradient)
    mean = np.einsum("...i,...i->...", gradient, totals)
    variance = (squares - mean**2 / episodes) * episodes / max(episodes - 1, 1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _degrees(deviations: Floats, errors: Floats) -> float:
    """The degrees of freedom at which Student's t has the 95 % point of the resamples.

    The result is 0 if that point is beyond the point of t with `FEWEST_DEGREES`.
    """
    defined = ~np.isnan(deviations) & ~np.isnan(errors)
    deviations, errors = np.abs(deviations[defined]), errors[defined]
    # A resample without any episode that differs has an unknown error.
    ratio = np.where(deviations > 0, np.inf, 0.0)
    np.divide(deviations, errors, out=ratio, where=errors > 0)
    point = float(np.quantile(ratio, CONFIDENCE, method="higher")) if ratio.size else np.inf
    if point > stats.t.ppf(UPPER, FEWEST_DEGREES):
        return 0.0
    if point <= stats.t.ppf(UPPER, MANY_DEGREES):
        return MANY_DEGREES
    bracket = (FEWEST_DEGREES, MANY_DEGREES)
    return float(optimize.brentq(lambda degrees: stats.t.ppf(UPPER, degrees) - point, *bracket))


def holm(p: Floats) -> Floats:
    """P-values corrected for their number (Holm 1979)."""
    order = np.argsort(p)
    scaled = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(scaled, 1.0)
    return corrected
