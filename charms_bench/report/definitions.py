"""Columns for metrics: what each metric means, which a stored table does not say itself."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import polars as pl

from charms_bench.errors import CharmsBenchError
from charms_bench.metrics import MetricSet
from charms_bench.metrics.labels import label_of
from charms_bench.metrics.metric import Interval
from charms_bench.report.table import Column
from charms_bench.runs.metric_sets import asked_by, metric_sets

INTERVALS: Mapping[Interval, str] = {
    "bootstrap": "percentiles of resampled episodes",
    "proportion": "Wilson's score interval with the effective sample size of correlated "
    "observations",
    "rate": "score interval of a Poisson rate with the effective number of correlated events",
    "wilson": "Wilson's score interval of a proportion of episodes",
    "garwood": "Garwood's exact interval of a Poisson rate",
}
LEFT_OUT = "scenarios_left_out"
"""What long frames call the proportion of concrete scenarios that their numbers leave out; see
`engine.pile_ups`."""


def said_of_left_out(frame: pl.DataFrame, column: str) -> str:
    """The sentence for a long frame, whose `column` has the names; empty if nothing is left out."""
    rows = frame.filter(pl.col(column) == LEFT_OUT, pl.col("value") > 0)
    found = dict.fromkeys(rows.select("traffic", "value", "n").iter_rows())
    counts = ", ".join(f"{round(value * n):,} of {n:,} of {traffic}" for traffic, value, n in found)
    return counts and (
        f"Left out are the concrete scenarios in which prescribed vehicles collide with one "
        f"another: {counts}."
    )


def columns_of(metric_set: MetricSet) -> dict[str, Column]:
    """The columns of a metric set, by metric."""
    return {
        metric.name: Column(
            name=metric.name,
            unit=metric.unit,
            definition=metric.description,
            counted=metric.rests_on,
            interval=INTERVALS[metric.interval],
            group=metric_set.label,
            form="" if metric.unit else "%",
            label=label_of(metric.name, metric_set.label),
        )
        for metric in metric_set.metrics
    }


def installed_column(label: str, metric: str) -> Column:
    """The column of a metric, from the label of its set in a stored table.

    A metric whose set is not installed, or is installed in another version, is said to be unknown.
    """
    unknown = Column(
        name=metric,
        definition=f"Unknown: the metric set {label} is not installed where this was made",
        counted="unknown",
        interval="unknown",
        group=label,
        label=label_of(metric, label),
    )
    return _installed(label).get(metric, unknown)


@lru_cache
def _installed(label: str) -> dict[str, Column]:
    try:
        (found,) = metric_sets([asked_by(label) or label])
    except CharmsBenchError:
        return {}
    return columns_of(found) if found.label == label else {}


def first_column(metric: str, metric_sets: Sequence[MetricSet]) -> Column:
    """The column of a metric, from the first of some metric sets that has it."""
    found = filter(None, (columns_of(each).get(metric) for each in metric_sets))
    return next(found, None) or installed_column("unknown", metric)
