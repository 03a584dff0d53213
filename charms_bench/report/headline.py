"""The table that is the point of a suite, compact enough for one screen.

What the suite declares decides which one it is. Human driving to compare with: the distances from
it. A reference driver: who crashes, which of these collisions are preventable, and how hard the
egos brake. Pairs, but not on several roads: in how many metrics each two egos differ. Several egos
on several roads or in several traffic models: the matrix of the suite's first metric that has one.
In every other suite, it is the table of the suite's first columns.
"""

from dataclasses import replace
from itertools import chain

from charms_bench.report.definitions import said_of_left_out
from charms_bench.report.number import Number
from charms_bench.report.stored import RunTables
from charms_bench.report.suite_table import MATRICES, matrices, one_per_metric, printed, time_over
from charms_bench.report.table import Column, Row, Table
from charms_bench.runs.suite import Suite

DISTANCE = "js"
"""The distance from human driving that is shown: it has bounds, and needs no smoothing."""
QUANTITY = {"speed": "Speed", "dhw": "Headway"}


def headline(suite: Suite, tables: RunTables) -> Table:
    """The table that is the point of a suite, from the tables of its run."""
    if tables.realism is not None:
        found = _realism(tables.realism)
    elif tables.preventable is not None:
        return tables.preventable.without_constant_keys()
    elif tables.pairs is not None and len(suite.roads) < 2:
        found = pair_matrix(tables.pairs)
    else:
        start = f"{suite.suite}-"
        by_metric = {each.name.removeprefix(start): each for each in matrices(tables.metrics)}
        shown = [by_metric[name] for name in (*suite.columns, *MATRICES) if name in by_metric]
        found = shown[0] if shown else _columns(suite, tables.metrics)
    frame = tables.metrics.frame()
    said = said_of_left_out(frame, "metric"), time_over(frame)
    return replace(found, note=" ".join(filter(None, (found.note, *said))))


def pair_matrix(pairs: Table) -> Table:
    """In how many metrics each two egos differ, from the table of pairs; egos have numbers."""
    names = list(dict.fromkeys(chain.from_iterable(row.labels[:2] for row in pairs.rows)))
    apart = {row.labels[:2]: sum(number.marked for number in row.numbers) for row in pairs.rows}
    rows = [
        Row(
            (f"{k} {one}",),
            tuple(Number(apart.get((one, other), apart.get((other, one)))) for other in names),
        )
        for k, one in enumerate(names, 1)
    ]
    compared = "; ".join(column.heading for column in pairs.columns)
    return Table(
        f"{pairs.name}-matrix",
        f"In how many of {len(pairs.columns)} metrics each two egos differ",
        ("ego",),
        tuple(Column(str(k), form=".0f") for k in range(1, len(names) + 1)),
        tuple(rows),
        note=f"They differ in a metric if p < 0.05, corrected over all pairs and metrics by Holm's "
        f"method. Metrics: {compared}.",
    )


def _realism(table: Table) -> Table:
    places = [i for i, each in enumerate(table.columns) if each.name.startswith(f"{DISTANCE}_")]
    chosen = table.take(places)
    names = (f"{QUANTITY[each.quantity]}, {each.group}" for each in chosen.columns)
    return replace(
        chosen.named(*names).without_groups(),
        title="Distance from human driving: Jensen-Shannon divergence, from 0 (the same) to 1",
        note="*: nearest to human driving, separated from every other traffic model.",
    )


def _columns(suite: Suite, table: Table) -> Table:
    """The suite's columns in its own order, one per metric."""
    found = one_per_metric(printed(table, suite.columns))
    places = {column.name: i for i, column in enumerate(found.columns)}
    order = [places[name] for name in suite.columns if name in places] or list(places.values())
    return replace(found.take(order).without_groups(), title="", note="")
