"""An evaluation's stored tables for a terminal: every number with its interval, drawn to scale."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import polars as pl
from rich.console import Group
from rich.table import Table
from rich.text import Text

from charms_bench.metrics import METRIC_SETS
from charms_bench.report.bars import INTERVAL, PAPER, VALUE, Scale, bar
from charms_bench.report.tables import decimals_of, written

NARROWEST, WIDEST = 8, 44
"""Characters of a bar."""
GAP = 2
ENDS = ("low", "high")
LEGEND = f"{INTERVAL * 2}{VALUE}{INTERVAL * 2} value in its 95 % interval"

Row = Mapping[str, Any]


class Layout(NamedTuple):
    """How a stored table is to be read."""

    title: str
    value: str
    """The column drawn, between `low` and `high`."""
    groups: tuple[str, ...]
    """The columns whose rows share a scale; the last is the metric's name."""
    labels: tuple[str, ...]
    """The columns that tell the rows of a scale apart."""
    between: str = ""
    """What stands between two labels."""


class Line(NamedTuple):
    """A row as it is printed."""

    texts: tuple[str, str, str, str]
    """Label, value, interval and the paper's value."""
    row: Row
    """The numbers; empty in a heading."""


LAYOUTS = {
    "": Layout("", "value", ("metric_set", "metric"), ("agent", "traffic"), " in"),
    "-realism": Layout("Traffic against people", "value", ("reference", "metric"), ("traffic",)),
    "-pairs": Layout(
        "Pairs of egos, first less second; * is separated from 0",
        "difference",
        ("metric",),
        ("first", "second"),
        " less",
    ),
}
"""Of each of `stored.TABLES`."""


def chosen_metrics(tables: Mapping[str, pl.DataFrame], columns: Sequence[str]) -> list[str]:
    """The metrics to show unless asked otherwise: a suite's columns, or what the paper reports.

    Args:
        tables: As `stored.stored_tables` has them.
        columns: The suite's.

    Returns:
        Names; none where neither says any.
    """
    long = tables[""]
    there = set(long["metric"])
    if found := [name for name in columns if name in there]:
        return found
    reported = long.filter(pl.col("paper").is_not_null())
    return reported["metric"].unique(maintain_order=True).to_list()


def render(tables: Mapping[str, pl.DataFrame], metrics: Sequence[str], width: int = 100) -> Group:
    """Tables for a terminal.

    Args:
        tables: As `stored.stored_tables` has them.
        metrics: Of the first table, in this order; none: all. The other tables are shown whole.
        width: Of the terminal, in characters.
    """
    parts: list[Text | Table] = []
    for end, table in tables.items():
        layout = LAYOUTS[end]
        if end == "" and metrics:
            places = {name: place for place, name in enumerate(metrics)}
            order = pl.col("metric").replace_strict(places, default=None)
            table = table.filter(order.is_not_null()).sort(
                pl.col("metric_set").rank("dense"), order, maintain_order=True
            )
        if layout.title:
            parts.append(Text(f"\n{layout.title}", style="bold"))
        parts += _tables(table, layout, width)
    compared = tables[""]["paper"].is_not_null().any()
    parts.append(Text("\n" + LEGEND + (f"; {PAPER} the paper's value" if compared else "")))
    return Group(*parts)


def _tables(long: pl.DataFrame, layout: Layout, width: int) -> Iterable[Text | Table]:
    """A heading and a table for each value of the first of several groups."""
    *outer, metric = layout.groups
    for key, part in long.group_by(outer or pl.lit(""), maintain_order=True):
        if outer:
            yield Text(f"\n{key[0]}", style="bold")
        yield _table(part, layout, metric, str(key[0]), width)


def _table(long: pl.DataFrame, layout: Layout, metric: str, heading: str, width: int) -> Table:
    """A block a metric: its scale, then a row a cell, under its ego where that varies too."""
    labels = [name for name in layout.labels if long[name].n_unique() > 1] or [layout.labels[0]]
    units = _units(heading)
    blocks = [
        _block(str(name), units.get(str(name), ""), part.rows(named=True), layout, labels)
        for (name,), part in long.group_by(metric, maintain_order=True)
    ]
    taken = [max(len(line.texts[i]) for block in blocks for line in block) for i in range(4)]
    label_width = min(taken[0], max(NARROWEST, width - sum(taken[1:]) - 2 * NARROWEST - 4 * GAP))
    room = min(WIDEST, max(NARROWEST, width - label_width - sum(taken[1:]) - 4 * GAP))
    table = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False, show_header=False)
    table.add_column(width=label_width, no_wrap=True)
    table.add_column(width=taken[1], justify="right", no_wrap=True)
    table.add_column(width=taken[2], justify="right", no_wrap=True)
    table.add_column(width=room, no_wrap=True)
    table.add_column(width=taken[3], justify="right", no_wrap=True)
    for index, block in enumerate(blocks):
        numbers = [line.row.get(key) for line in block for key in (layout.value, *ENDS, "paper")]
        scale = Scale.over(numbers, room, zero=layout.value == "difference")
        if index:
            table.add_row()
        for line in block:
            label, value, interval, paper = line.texts
            if line.row:
                low, high = (line.row[end] for end in ENDS)
                drawn = bar(scale, line.row[layout.value], low, high, line.row.get("paper"))
            else:
                drawn = _axis(scale) if line is block[0] else Text()
            style = "bold" if line is block[0] else ""
            table.add_row(Text(label, style=style), value, interval, drawn, paper)
    return table


def _block(
    name: str, unit: str, rows: Sequence[Row], layout: Layout, labels: Sequence[str]
) -> list[Line]:
    decimals = decimals_of({"paper": None, **row, "value": row[layout.value]} for row in rows)
    sign, joined = ("+", ", ") if layout.value == "difference" else ("", "–")
    compared = any(row.get("paper") is not None for row in rows)
    lines = [Line((name, "", unit, "paper" if compared else ""), {})]
    above = None
    for row in rows:
        *outer, label = (str(row[column]) for column in labels)
        if outer and outer != above:
            lines.append(Line((f"  {outer[0]}{layout.between}", "", "", ""), {}))
        above = outer
        value = written(row[layout.value], decimals, sign) + ("*" if row.get("separated") else "")
        ends = [written(row[end], decimals, sign) for end in ENDS if row[end] is not None]
        paper = "" if row.get("paper") is None else written(row["paper"], decimals)
        indented = "  " * (1 + len(outer)) + label
        lines.append(Line((indented, value, joined.join(ends), paper), row))
    return lines


def _units(metric_set: str) -> dict[str, str]:
    """Units by metric, of a metric set that comes with the harness."""
    name = metric_set.partition("(")[0]
    return {
        metric.name: metric.unit
        for known in METRIC_SETS
        if known.label == name
        for metric in known.metrics
    }


def _axis(scale: Scale) -> Text:
    """The ends of a scale, above its bars."""
    low, high = f"{scale.low:.4g}", f"{scale.high:.4g}"
    return Text(low + high.rjust(scale.width - len(low)), style="dim")
