"""Two agents side by side in every metric: the difference, and what can be said of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from charms_bench.errors import InputError, suggestion
from charms_bench.metrics import Metric, MetricSet, sums_by_episode
from charms_bench.report.tables import NOTHING
from charms_bench.runs.cells import CellRows
from charms_bench.statistics.intervals import CONFIDENCE, resample
from charms_bench.statistics.paired import Difference, differences, holm
from charms_bench.world.scene import SceneSettings


@dataclass(frozen=True)
class Compared:
    """Two agents in one traffic by one metric."""

    first: str
    second: str
    traffic: str
    metric_set: str
    metric: str
    episodes: int
    first_value: float
    second_value: float
    difference: Difference
    corrected_p: float
    """After Holm, over all metrics and pairs that were asked for."""

    @property
    def separated(self) -> bool:
        """Whether the agents differ by more than chance would have it."""
        return self.corrected_p < 1 - CONFIDENCE

    def to_dict(self) -> dict[str, Any]:
        """For JSON: what is not defined is None."""
        numbers = {
            "first_value": self.first_value,
            "second_value": self.second_value,
            "difference": self.difference.value,
            "low": self.difference.low,
            "high": self.difference.high,
            "detectable": self.difference.detectable,
            "p": self.difference.p,
            "corrected_p": self.corrected_p,
        }
        return {
            "first": self.first,
            "second": self.second,
            "traffic": self.traffic,
            "metric_set": self.metric_set,
            "metric": self.metric,
            "episodes": self.episodes,
            **{key: None if math.isnan(number) else number for key, number in numbers.items()},
            "separated": self.separated,
        }


def compare(
    pairs: Sequence[tuple[CellRows, CellRows]],
    metric_sets: Sequence[MetricSet],
    settings: SceneSettings,
    seed: int,
    only: Sequence[str] = (),
) -> list[Compared]:
    """Every metric of every pair, first less second.

    Args:
        pairs: Two agents in the same episodes each.
        metric_sets: What is measured.
        settings: What the scenes have in common.
        seed: Of the resamples.
        only: Names of metrics, of each set that has them; none: all.

    Raises:
        InputError: There is no metric of such a name.
    """
    chosen = _chosen(metric_sets, only)
    metrics = [metric for _, metric in chosen]
    found = []
    for pair in pairs:
        first, second = (
            sums_by_episode(metrics, cell.episodes, cell.steps, settings) for cell in pair
        )
        weights = resample(np.random.default_rng(seed), len(pair[0].episodes))
        found += [
            Compared(
                first=pair[0].agent,
                second=pair[1].agent,
                traffic=pair[0].traffic,
                metric_set=label,
                metric=metric.name,
                episodes=len(ours),
                first_value=float(metric.value(ours.sum(axis=0))),
                second_value=float(metric.value(theirs.sum(axis=0))),
                difference=difference,
                corrected_p=difference.p,
            )
            for (label, metric), ours, theirs, difference in zip(
                chosen, first, second, differences(metrics, first, second, weights), strict=True
            )
        ]
    corrected = holm(np.array([row.difference.p for row in found]))
    return [replace(row, corrected_p=float(p)) for row, p in zip(found, corrected, strict=True)]


def _chosen(metric_sets: Sequence[MetricSet], only: Sequence[str]) -> list[tuple[str, Metric]]:
    every = [(each.label, metric) for each in metric_sets for metric in each.metrics]
    known = {metric.name: metric for _, metric in every}
    for name in only:
        if name not in known:
            raise InputError(f"no metric named '{name}'. {suggestion(name, known)}")
    return [(label, metric) for label, metric in every if not only or metric.name in only]


def render(rows: Sequence[Compared]) -> Group:
    """Tables for a terminal, one a pair and metric set, and what their columns mean."""
    parts: list[Table | Text] = []
    for (first, second, traffic, label), found in groupby(
        rows, lambda row: (row.first, row.second, row.traffic, row.metric_set)
    ):
        title = Text(f"{first} less {second}, in {traffic}: {label}")
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("metric", no_wrap=True)
        for header in ("first", "second", "difference", "95 % interval", "p", "detectable"):
            table.add_column(header, justify="right")
        for row in found:
            table.add_row(*_cells(row), style="bold" if row.separated else "")
        parts.append(table)
    apart = sum(row.separated for row in rows)
    episodes = ", ".join(f"{count:,}" for count in sorted({row.episodes for row in rows}))
    legend = (
        f"{apart} of {len(rows)} differences are separated from 0 (*): p, corrected for "
        f"{len(rows)} tests by Holm's method, is below 0.05. detectable: the smallest true "
        f"difference that as many episodes ({episodes}) show in 80 % of cases, before the "
        "correction."
    )
    return Group(*parts, Text(legend))


def _cells(row: Compared) -> list[str]:
    found = row.difference
    margin = found.high - found.value
    # Two digits of the margin are all that a difference is known to.
    decimals = max(0, 1 - math.floor(math.log10(margin))) if margin > 0 else 3
    low, high = (f"{number:+.{decimals}f}" for number in (found.low, found.high))
    p = "<0.001" if row.corrected_p < 0.001 else f"{row.corrected_p:.3f}"
    return [
        row.metric,
        _number(row.first_value),
        _number(row.second_value),
        NOTHING if math.isnan(found.value) else f"{found.value:+.{decimals}f}",
        NOTHING if math.isnan(found.low) else f"{low}, {high}",
        p + ("*" if row.separated else " "),
        NOTHING if math.isnan(found.detectable) else f"{found.detectable:.2g}",
    ]


def _number(number: float) -> str:
    return NOTHING if math.isnan(number) else f"{number:.4g}"
