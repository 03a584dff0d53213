"""Values of training seeds: their mean with Student's t interval, the worst, and their tables."""

from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
from scipy import special

from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.statistics.intervals import CONFIDENCE
from charms_bench.world.scene import Floats

SEED = ", seed "
"""Stands between the label of a training configuration and its seed."""
OVER = "over the seeds"
Worst = Callable[[Floats], float]
Columns = dict[str, tuple[str, str, Worst | None]]
"""Header and format of each metric, and which of the seeds' values is the worst, if any is."""


def mean_of(values: Floats, low: float = -np.inf, high: float = np.inf) -> Number:
    """The mean of seeds with its interval, if there are several, cut to what values can be."""
    n = len(values)
    if n < 2:
        return Number(float(values.mean()) if n else None, n=n)
    mean, t = values.mean(), special.stdtrit(n - 1, (1 + CONFIDENCE) / 2)
    margin = t * values.std(ddof=1) / np.sqrt(n)
    return Number(mean, max(mean - margin, low), min(mean + margin, high), n)


def summary(values: pl.DataFrame, columns: Columns, keys: tuple[str, ...]) -> str:
    """The table of configurations from the metrics of every seed, as Markdown.

    A configuration without seeds has one row, others have the mean and the worst seed. No metric
    is negative. The last key says which of the two a row has.
    """
    records: list[dict[str, Any]] = []
    for labels, part in values.group_by(keys[:-1], maintain_order=True):
        over = f"mean of {part.height} [t interval]" if part.height > 1 else ""
        mean: dict[str, Any] = dict(zip(keys, (*labels, over), strict=True))
        worst: dict[str, Any] = dict(zip(keys, (*[""] * len(labels), "worst seed"), strict=True))
        for metric, (header, form, worst_of) in columns.items():
            found = part[metric].drop_nulls().drop_nans().to_numpy()
            mean[header] = mean_of(found, 0.0, 1.0 if form.endswith("%") else np.inf)
            worst[header] = worst_of(found) if worst_of and len(found) else ""
        records += [mean, worst] if part.height > 1 else [mean]
    return markdown(Table.plain(records, keys, {h: form for h, form, _ in columns.values()}))
