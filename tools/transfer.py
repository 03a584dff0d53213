"""How the egos of `suites/ego.yaml` do out of what they were trained in, for `write_results.py`.

The conditions are the traffic models of the run folders `transfer-*` and `released-transfer`:
drivers with other parameters, learned drivers, other densities and other numbers of lanes.
"""

from dataclasses import replace
from pathlib import Path

import polars as pl
from result_pages import RESULTS

from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.stored import stored_tables
from charms_bench.report.table import Column, Row, Table
from charms_bench.runs.resumable_folder import RunFolder

METRICS = {
    "crashed_episodes": "crashed in the worst of other conditions",
    "crashed_at_fault": "crashed at fault in the worst of other conditions",
}
"""Metrics, and the header of each as a column in the table of egos."""
CONDITIONS = {
    "transfer-traffics": "",
    "released-transfer": "the authors' ",
    "transfer-density-0-7": "density 0.7",
    "transfer-density-1-5": "density 1.5",
    "transfer-density-2-0": "density 2",
    "transfer-lanes-2": "2 lanes",
    "transfer-lanes-4": "4 lanes",
    "transfer-lanes-5": "5 lanes",
}
"""Names of run folders. One with several traffic models gives a condition for each, after this
prefix."""


def crashed_elsewhere(runs: Path, metric: str) -> dict[str, dict[str, Number]]:
    """A metric of `METRICS` by condition and ego."""
    found: dict[str, dict[str, Number]] = {}
    for name, said in CONDITIONS.items():
        if not (runs / name).is_dir():
            continue
        table = stored_tables(runs / name, RunFolder(runs / name).suite()).metrics
        place = [column.name for column in table.columns].index(metric)
        several = len({row.labels[1] for row in table.rows}) > 1
        for row in table.rows:
            condition = said + row.labels[1] if several else said
            found.setdefault(condition, {})[row.labels[0]] = row.numbers[place]
    return found


def transfer(run: Path) -> str:
    """The crashes at fault, one condition per row; a CSV file has all crashes, too."""
    _numbers(run.parent).write_csv(RESULTS / "transfer.csv")
    found = crashed_elsewhere(run.parent, "crashed_at_fault")
    egos = dict.fromkeys((ego for numbers in found.values() for ego in numbers), ".1%")
    records = ({"condition": condition, **numbers} for condition, numbers in found.items())
    return markdown(Table.plain(records, ("condition",), egos))


def _numbers(runs: Path) -> pl.DataFrame:
    """One row per metric of `METRICS`, condition and ego: the value and its interval."""
    return pl.DataFrame(
        [
            (metric, condition, ego, number.value, number.low, number.high)
            for metric in METRICS
            for condition, numbers in crashed_elsewhere(runs, metric).items()
            for ego, number in numbers.items()
        ],
        schema=["metric", "condition", "ego", "value", "low", "high"],
        orient="row",
    )


def with_worst(table: Table, runs: Path) -> Table:
    """The table of egos with the largest proportion in any condition, for each of `METRICS`.

    The columns of the table begin with those of `METRICS`.
    """
    columns = list(table.columns)
    numbers = {row.labels: list(row.numbers) for row in table.rows}
    for place, (metric, header) in enumerate(METRICS.items()):
        at = 2 * place + 1
        columns.insert(at, Column(header, form=".1%"))
        conditions = crashed_elsewhere(runs, metric).values()
        for labels, own in numbers.items():
            found = [each[labels[0]] for each in conditions if labels[0] in each]
            own.insert(at, max(found, key=lambda each: each.value or 0.0, default=Number()))
    rows = tuple(Row(labels, tuple(own)) for labels, own in numbers.items())
    return replace(table, columns=tuple(columns), rows=rows)
