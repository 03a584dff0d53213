"""The comparison of two agents over the same episodes: every metric, and which ones differ."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from charms_bench.metrics import MetricSet
from charms_bench.metrics.labels import set_label_of
from charms_bench.report.definitions import installed_column
from charms_bench.report.number import Number
from charms_bench.report.table import Column, Row, Table, check_metrics
from charms_bench.runs.cells import title_of
from charms_bench.runs.pairing import Pair
from charms_bench.statistics.intervals import CONFIDENCE, resample
from charms_bench.statistics.paired import differences, holm
from charms_bench.world.scene import SceneSettings

KEYS = ("first", "second", "traffic", "metric_set", "metric")
WITH_ROAD = ("first", "second", "road", "traffic", "metric_set", "metric")
COLUMNS = (
    Column("first_value", definition="value of the first agent", form=".4g"),
    Column("second_value", definition="value of the second agent", form=".4g"),
    Column(
        "difference",
        definition="first minus second",
        counted="episodes",
        interval="paired: Tango's score interval for proportions of episodes, else bootstrap-t; "
        "if only a few episodes differ in a proportion or a rate, from the intervals of the two "
        "agents",
        form="margin",
        signed=True,
    ),
    Column("corrected_p", definition="p-value, corrected for all tests by Holm", form="p"),
    Column(
        "detectable",
        definition="smallest true difference that as many episodes show in 80 % of cases, before "
        "the correction",
        form=".2g",
    ),
    Column("p", definition="p-value of this test alone", form="p"),
)


def compare(
    pairs: Sequence[Pair],
    metric_sets: Sequence[MetricSet],
    settings: SceneSettings,
    seed: int,
    only: Sequence[str] = (),
) -> Table:
    """Every metric of every pair, first minus second, one metric per row.

    The pairs are from `runs.pairing.pairs_of`, and the seed is that of the resamples. `only` names
    metrics, in every set that has them; none means all. An `InputError` if there is no such metric.
    """
    every = [(each.label, metric) for each in metric_sets for metric in each.metrics]
    check_metrics(only, {metric.name: metric for _, metric in every})
    chosen = [(label, metric) for label, metric in every if not only or metric.name in only]
    metrics = [metric for _, metric in chosen]
    keys = WITH_ROAD if pairs[0][0].road else KEYS
    records: list[dict[str, Any]] = []
    for pair in pairs:
        first, second = (cell.sums(metrics, settings) for cell in pair)
        weights = resample(np.random.default_rng(seed), pair[0].size)
        found = differences(metrics, first, second, weights)
        for (label, metric), ours, theirs, each in zip(chosen, first, second, found, strict=True):
            labels = (pair[0].agent, pair[1].agent, *pair[0].labels[1:], label, metric.name)
            value, low, high = map(defined, (each.value, each.low, each.high))
            records.append(
                {
                    **dict(zip(keys, labels, strict=True)),
                    "first_value": defined(float(metric.value(ours.sum(axis=0)))),
                    "second_value": defined(float(metric.value(theirs.sum(axis=0)))),
                    "difference": Number(value, low, high, len(ours)),
                    "detectable": defined(each.detectable),
                    "p": each.p,
                }
            )
    corrected = holm(np.array([record["p"] for record in records])).tolist()
    apart = [p < 1 - CONFIDENCE for p in corrected]
    for record, p, marked in zip(records, corrected, apart, strict=True):
        record["corrected_p"] = p
        record["difference"] = replace(record["difference"], p=p, marked=marked)
    episodes = ", ".join(f"{n:,}" for n in sorted({record["difference"].n for record in records}))
    note = (
        f"{sum(apart)} of {len(apart)} differences are separated from 0 (marked): p, corrected "
        f"for {len(apart)} tests by Holm's method, is below 0.05. detectable: the "
        f"{COLUMNS[4].definition}. Episodes: {episodes}."
    )
    numbers = [record["difference"] for record in records if not record["difference"].marked]
    if alone := sum((each.low or 0) > 0 or (each.high or 0) < 0 for each in numbers):
        note += (
            f" Not marked, although the interval is without 0: {alone}. An interval is that of one "
            "test, and some of many tests differ by chance. For fewer tests, choose the metrics "
            "before you look (--metric; in Python: metrics)."
        )
    title = "First agent minus second"
    return Table.from_records(records, "comparison", title, keys, COLUMNS, note)


def defined(value: float) -> float | None:
    """The value, None for NaN."""
    return None if np.isnan(value) else value


def by_pair(table: Table, metrics: Collection[str] | None = None) -> list[Table]:
    """A table to read for each pair of agents, traffic and metric set; the last has the note.

    p is the corrected one, for the tests of all metrics. If `metrics` are given, only they are
    shown.
    """
    shown = table.take(range(len(COLUMNS) - 1))
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in shown.rows:
        if metrics is None or row.labels[-1] in metrics:
            groups.setdefault(row.labels[:-1], []).append(_headed(row))
    found = [
        replace(
            shown.named(first, second, "difference", "p", "detectable"),
            title=f"{first} minus {second}, in {title_of(place)}: {set_label_of(metric_set)}",
            keys=KEYS[-1:],
            rows=tuple(rows),
            note="",
        )
        for (first, second, *place, metric_set), rows in groups.items()
    ]
    return [*found[:-1], *(replace(each, note=table.note) for each in found[-1:])]


def _headed(row: Row) -> Row:
    """A row with the heading of its metric as its label, and proportions in percent."""
    column = installed_column(*row.labels[-2:])
    if column.form != "%":
        return replace(row, labels=(column.title,))
    numbers = (number.scaled(100.0) for number in row.numbers[:3])
    *_, p, detectable = row.numbers
    cells = (*numbers, p, detectable.scaled(100.0))
    return replace(row, labels=(f"{column.heading} (%)",), cells=cells)


def to_dicts(table: Table) -> list[dict[str, Any]]:
    """A comparison for JSON: a dictionary per row; undefined values are None."""
    place = table.columns.index(COLUMNS[2])
    return [
        {**record, "episodes": each.n, "low": each.low, "high": each.high, "separated": each.marked}
        for record, each in zip(table.records(), table.column(place), strict=True)
    ]
