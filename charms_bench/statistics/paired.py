"""How far two agents are apart over the same episodes: differences, intervals, p-values.

A seed is the same episode to both agents, so episodes are pairs, and what makes an episode hard
does not blur the difference. Shares of episodes get McNemar's exact test (McNemar 1947) and the
score interval of Tango (1998, Statistics in Medicine 17). Everything else is a function of sums
over episodes: the standard error of its difference follows from the sums by linearisation, and
resampled episodes say how heavy the tails of the difference over its standard error are (the
symmetric bootstrap-t, Hall 1988, Annals of Statistics 16). That is Student's t with the degrees
of freedom whose 95 % point the resamples have, which serves the interval and the p-value alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from charms_bench.metrics.metric import Metric
from charms_bench.statistics.intervals import CONFIDENCE, NO_BOUNDS, Bounds
from charms_bench.world.scene import Floats

POWER = 0.8
UPPER = (1 + CONFIDENCE) / 2
FEWEST_DEGREES = 1.0
"""Heavier tails than Student's t has with these leave no interval to speak of."""
MANY_DEGREES = 1e6
STEP = 1e-6
"""Of numerical gradients, relative: the cube root of a double's precision, about."""


@dataclass(frozen=True)
class Difference:
    """First less second; NaN stands for what is not defined."""

    value: float
    low: float
    high: float
    p: float
    """Two-sided, not corrected for the number of tests; 1 where there is nothing to test."""
    detectable: float
    """The smallest true difference that as many episodes show in 80 % of cases, at a two-sided
    level of 5 %: the standard error times the sum of the 97.5 % and 80 % points."""


def differences(
    metrics: Sequence[Metric], first: Sequence[Floats], second: Sequence[Floats], weights: Floats
) -> list[Difference]:
    """The difference of two agents in each metric.

    Args:
        metrics: What is compared.
        first: The first agent's sums [E, k], a row an episode (`metrics.sums_by_episode`).
        second: The second's, of the same episodes.
        weights: [R, E], resampled episodes (`stats.resample`).
    """
    return [
        _of_shares(ours, theirs)
        if metric.interval == "wilson"
        else _of_sums(metric.value, ours, theirs, weights)
        for metric, ours, theirs in zip(metrics, first, second, strict=True)
    ]


def _of_shares(ours: Floats, theirs: Floats) -> Difference:
    n, events = len(ours), (ours[:, -1] > 0, theirs[:, -1] > 0)
    only_first = int((events[0] & ~events[1]).sum())
    only_second = int((events[1] & ~events[0]).sum())
    if not n:
        return Difference(np.nan, *NO_BOUNDS, 1.0, np.nan)
    # Half an episode in each cell of the table (Agresti & Min 2005, Statistics in Medicine 24):
    # without, agents that never differ would seem to be told apart by anything.
    unlike = (only_first + only_second + 1) / (n + 2)
    error = np.sqrt((unlike - ((only_first - only_second) / (n + 2)) ** 2) / (n + 2))
    return Difference(
        (only_first - only_second) / n,
        *tango(only_first, only_second, n),
        mcnemar(only_first, only_second),
        float((stats.norm.ppf(UPPER) + stats.norm.ppf(POWER)) * error),
    )


def mcnemar(only_first: int, only_second: int) -> float:
    """The exact p-value that a pair is as likely to differ in one way as in the other."""
    unlike = only_first + only_second
    return float(stats.binomtest(only_first, unlike).pvalue) if unlike else 1.0


def tango(only_first: int, only_second: int, pairs: int) -> Bounds:
    """The score interval of a paired difference of shares, Tango 1998."""

    def excess(difference: float, side: float) -> float:
        """How far the score is beyond the 95 % point; eqs. 2 and 3."""
        b = (2 * pairs - only_first + only_second) * difference - only_first - only_second
        c = -only_second * difference * (1 - difference)
        share = (np.sqrt(max(b * b - 8 * pairs * c, 0.0)) - b) / (4 * pairs)
        variance = max(pairs * (2 * share + difference * (1 - difference)), 0.0)
        score = only_first - only_second - pairs * difference
        return float(score - side * stats.norm.ppf(UPPER) * np.sqrt(variance))

    value = (only_first - only_second) / pairs
    # At the value itself the score is 0 whatever the data, and so may the variance be.
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
    # As for McNemar: at best all the episodes that differ do so in one direction.
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

    An episode moves the function by its gradient times the episode's sums; the variance of the
    function is that of these moves, times the number of episodes.
    """
    gradient = np.empty_like(totals)
    for j in range(totals.shape[-1]):
        step = np.zeros_like(totals)
        step[..., j] = STEP * np.where(totals[..., j] == 0, 1.0, np.abs(totals[..., j]))
        # Nothing was counted: a step back would lead to less than that.
        back = np.where(totals == 0, 0.0, step)
        rise = difference(totals + step) - difference(totals - back)
        gradient[..., j] = rise / (step + back)[..., j]
    second_moments = products.reshape(*totals.shape, -1)
    squares = np.einsum("...i,...ij,...j->...", gradient, second_moments, gradient)
    mean = np.einsum("...i,...i->...", gradient, totals)
    variance = (squares - mean**2 / episodes) * episodes / max(episodes - 1, 1)
    result: Floats = np.sqrt(np.maximum(variance, 0.0))
    return result


def _degrees(deviations: Floats, errors: Floats) -> float:
    """The degrees of freedom at which Student's t has the 95 % point of the resamples.

    Below `FEWEST_DEGREES` where that point is further out than t's with so few.
    """
    defined = ~np.isnan(deviations) & ~np.isnan(errors)
    deviations, errors = np.abs(deviations[defined]), errors[defined]
    # A resample without any of the episodes that differ: nothing is known of its error.
    ratio = np.where(deviations > 0, np.inf, 0.0)
    np.divide(deviations, errors, out=ratio, where=errors > 0)
    point = float(np.quantile(ratio, CONFIDENCE, method="higher")) if ratio.size else np.inf
    if point > stats.t.ppf(UPPER, FEWEST_DEGREES):
        return 0.0
    if point <= stats.t.ppf(UPPER, MANY_DEGREES):
        return MANY_DEGREES
    return float(
        optimize.brentq(
            lambda degrees: stats.t.ppf(UPPER, degrees) - point, FEWEST_DEGREES, MANY_DEGREES
        )
    )


def holm(p: Floats) -> Floats:
    """P-values corrected for their number, Holm 1979."""
    order = np.argsort(p)
    scaled = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(scaled, 1.0)
    return corrected
