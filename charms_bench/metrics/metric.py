"""What a metric is: sums of each episode's rows, and the value that follows from their totals.

A metric sees only totals over episodes. So the totals of resampled episodes give its interval, and
the totals of a run's shards add up to the totals of the run.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import polars as pl

from charms_bench.world.scene import Floats

Interval = Literal["bootstrap", "proportion", "rate", "wilson", "garwood"]
"""How a metric's 95 % interval is computed.

bootstrap: From resampled episodes; there is no interval if the resamples do not vary.
proportion: Wilson's interval with the effective sample size, for events correlated within episodes.
rate: The same per time or distance; the first sum is the most events that an episode can have.
wilson: For a proportion of episodes, each of which is one trial.
garwood: For the rate of an event that happens at most once per episode and ends it.
"""

EPISODES = pl.lit(1)
"""Counts episodes, as a sum of a metric."""


def ratio(totals: Floats) -> Floats:
    """The last sum divided by the sum before it."""
    below = totals[..., -2]
    result = np.full(below.shape, np.nan)
    np.divide(totals[..., -1], below, out=result, where=below > 0)
    return result


@dataclass(frozen=True)
class Metric:
    """A number that describes how an agent drives, or the traffic around it."""

    name: str
    unit: str
    """Empty for a proportion."""
    description: str
    rests_on: str
    """What `n` counts: steps, episodes, lane changes, ..."""
    sums: tuple[pl.Expr, ...]
    """k aggregations of an episode's rows (`rows.join_rows`); the first counts n."""
    value: Callable[[Floats], Floats] = ratio
    """[..., k] totals -> [...]; NaN where it is not defined."""
    interval: Interval = "bootstrap"


def problem_of_sums(metric: Metric, sums: Floats) -> str:
    """Why sums [E, k] have no interval of the metric's kind; empty if they have one."""
    if metric.interval == "bootstrap":
        return ""
    kind, events = f"its interval is '{metric.interval}'", sums[:, -1]
    if not (np.isfinite(sums).all() and (events >= 0).all()):
        return f"{kind}; expected sums that are finite and not negative"
    if metric.interval in ("proportion", "wilson"):
        trials = sums[:, 0 if metric.interval == "wilson" else -2]
        if (wrong := events > trials * (1 + 1e-9)).any():
            at = int(wrong.argmax())
            return f"{kind}, but an episode has {events[at]:g} events of {trials[at]:g}"
    return ""


@dataclass(frozen=True)
class MetricSet:
    """Metrics that are reported together; a changed definition gets a new version."""

    name: str
    version: int
    metrics: tuple[Metric, ...]
    options: str = ""
    """The options that it was made with, such as `ttc_s=2`."""

    @property
    def label(self) -> str:
        """The name in tables, such as `paper-2` or `standard-5(ttc_s=2)`."""
        return f"{self.name}-{self.version}" + (f"({self.options})" if self.options else "")


def in_name(threshold: float) -> str:
    """A threshold as part of a metric's name: 3.35 is `3_35`."""
    return f"{threshold:g}".replace(".", "_")


def total(expression: pl.Expr, where: pl.Expr) -> pl.Expr:
    """The sum of an expression over the rows where a condition holds."""
    return pl.when(where).then(expression).sum()


def root_mean_square(totals: Floats) -> Floats:
    """The root mean square, from (count, sum of squares)."""
    return np.asarray(np.sqrt(ratio(totals)))


def standard_deviation(totals: Floats) -> Floats:
    """The population's standard deviation, from (count, sum, sum of squares)."""
    mean_square = ratio(totals[..., [0, 2]])
    variance = mean_square - ratio(totals[..., [0, 1]]) ** 2
    # Of a constant, rounding leaves less than this.
    variance = np.where(variance < 1e-12 * mean_square, 0.0, variance)
    return np.asarray(np.sqrt(variance))


def per_episode(
    name: str,
    unit: str,
    value: pl.Expr,
    description: str,
    rests_on: str = "episodes",
    counts: pl.Expr = EPISODES,
    interval: Interval = "bootstrap",
) -> Metric:
    """The mean of a value that an episode has once, over the episodes that count."""
    return Metric(name, unit, description, rests_on, (counts, value), interval=interval)


def proportion_of_episodes(
    name: str,
    happens: pl.Expr,
    description: str,
    rests_on: str = "episodes",
    counts: pl.Expr = EPISODES,
) -> Metric:
    """The proportion of the episodes that count in which something happens."""
    return per_episode(name, "", happens, description, rests_on, counts, "wilson")
