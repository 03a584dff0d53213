"""The table of pairs: how far the egos of a suite differ, and how often one is guessed right.

All egos drive the same episodes, so differences are paired (`statistics.paired`); p-values are
corrected over all pairs and metrics (Holm 1979).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import polars as pl

from charms_bench.metrics import Metric
from charms_bench.report.definitions import first_column
from charms_bench.report.table import Column, Table, long_schema
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import CONFIDENCE, resample, wilson
from charms_bench.world.scene import Floats

KEYS = ("first", "second")
LONG = {
    "metric": "name",
    "difference": "value",  # first minus second
    "low": "low",
    "high": "high",
    "p": "p",
    "separated": "marked",
}
COMPARED = ("speed_mean", "dhw_mean", "harsh_acc_rate", "lane_changes_per_km")
"""Speed, headway, harshness and lane changes; from the first metric set that has the name."""
SUMMARY = (*COMPARED, "speed_std", "acc_std", "acc_mean", "dhw_std")
"""What describes an episode when its driver is guessed."""
FOLDS = 10


def pairs_table(suite: Suite, cells: Sequence[CellRows]) -> Table:
    """Each pair of egos by each metric of `COMPARED`: first minus second, with 95 % intervals.

    With roads, these are the pairs on each road.
    """
    from charms_bench.statistics import paired  # imports scipy.stats, which takes half a second

    metrics = _metrics(suite, COMPARED)
    sums = [cell.sums(metrics, suite.scene) for cell in cells]
    weights = resample(np.random.default_rng(suite.seed), cells[0].size)
    every = combinations(range(len(cells)), 2)
    pairs = [(i, j) for i, j in every if cells[i].road == cells[j].road]
    found = [paired.differences(metrics, sums[i], sums[j], weights) for i, j in pairs]
    records = [
        (*_labels(cells[i], cells[j]), metric.name, each.value, each.low, each.high, each.p)
        for (i, j), differences in zip(pairs, found, strict=True)
        for metric, each in zip(metrics, differences, strict=True)
    ]
    schema = long_schema(suite.with_road(KEYS), LONG)
    p = paired.holm(np.array([record[-1] for record in records]))
    frame = pl.DataFrame(records, schema=list(schema)[:-1], orient="row").with_columns(
        pl.col("difference", "low", "high").fill_nan(None),
        p=pl.Series(p),
        separated=pl.Series(p < 1 - CONFIDENCE),
    )
    return from_frame(frame, suite)


def _labels(first: CellRows, second: CellRows) -> Iterable[str]:
    return filter(None, (first.agent, second.agent, first.road))


def from_frame(frame: pl.DataFrame, suite: Suite) -> Table:
    """The table of pairs from its long frame."""

    def column(group: str, metric: str) -> Column:
        known = first_column(metric, suite.metric_sets)
        return replace(
            known,
            group=group,
            form="margin%" if known.form == "%" else "margin",
            signed=True,
            counted="",
            interval="paired, as in `charms-bench compare`",
        )

    return Table.from_frame(
        frame,
        f"{suite.suite}-pairs",
        "Pairs of egos",
        suite.with_road(KEYS),
        LONG,
        column,
        note="First minus second. Marked numbers are separated from 0: p < 0.05, corrected over "
        "all pairs and metrics by Holm's method.",
    )


def guessed(suite: Suite, cells: Sequence[CellRows]) -> tuple[int, int]:
    """In how many episodes the ego is guessed right from the episode's summary, and of how many.

    The guess is the ego with the nearest mean summary, each number in units of its standard
    deviation. Means are from other episodes than the guessed one: ten folds by seed.
    """
    metrics = _metrics(suite, SUMMARY)
    summaries = []
    for cell in cells:
        sums = cell.sums(metrics, suite.scene)
        values = [metric.value(each) for metric, each in zip(metrics, sums, strict=True)]
        summaries.append(np.stack(values, axis=1))
    features = np.stack(summaries)
    egos, episodes, _ = features.shape
    fold = np.random.default_rng(suite.seed).permutation(episodes) % min(FOLDS, episodes)
    folds = np.unique(fold)
    right = sum(_right(features[:, fold != k], features[:, fold == k]) for k in folds)
    return right, egos * episodes


def guess_summary(suite: Suite, cells: Sequence[CellRows]) -> str:
    """How often the ego is guessed right from one episode, beside the accuracy of chance.

    Empty if there are no other episodes to guess from, and if there are several roads.
    """
    if cells[0].size < 2 or len(suite.roads) > 1:
        return ""
    right, asked = guessed(suite, cells)
    low, high = wilson(right, asked)
    text = (
        f"From the summary of one episode, its ego is guessed right in {right / asked:z.1%} of "
        f"{asked:,} cases [{100 * low:z.1f}, {100 * high:z.1f}]; by chance it would be "
        f"{1 / len(cells):z.1%}."
    )
    return text.replace("%", " %")


def _right(known: Floats, asked: Floats) -> int:
    """How many of the summaries `asked` [egos, A, K] are nearest to their ego's mean of `known`."""
    flat = known.reshape(-1, known.shape[-1])
    defined = ~np.isnan(flat)
    count = np.maximum(defined.sum(axis=0), 1)
    mean = np.where(defined, flat, 0.0).sum(axis=0) / count
    spread = np.sqrt((np.where(defined, flat - mean, 0.0) ** 2).sum(axis=0) / count)
    spread[spread == 0] = 1.0

    def scaled(values: Floats) -> Floats:
        """A metric that is not defined in an episode tells nothing: it is put at the mean."""
        return np.asarray(np.nan_to_num((values - mean) / spread))

    centres = scaled(known).mean(axis=1)
    distance = ((scaled(asked)[:, :, None] - centres) ** 2).sum(axis=-1)
    return int((distance.argmin(axis=-1) == np.arange(len(known))[:, None]).sum())


def _metrics(suite: Suite, names: Sequence[str]) -> list[Metric]:
    known = [metric for metric_set in suite.metric_sets for metric in metric_set.metrics]
    return [next(metric for metric in known if metric.name == name) for name in names]
