"""A run's tables as a page shows them: every number with its interval, the paper's and a link."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import polars as pl

from charms_bench.report.html.definitions import Definition, define_set, define_stages, unknown
from charms_bench.report.tables import blocks, by_metric, cells_of, decimals_of, written

SIDE_BY_SIDE = 7
"""Metrics of a table, so that it fits a sheet of paper."""


@dataclass(frozen=True)
class Number:
    """A number of a table."""

    text: str
    value: float | None
    """What it is sorted by; None is last."""
    interval: str = ""
    paper: str = ""
    difference: str = ""
    """From the paper's."""
    n: str = ""
    strong: bool = False
    """Whether it stands out, for the reason that the table's note gives."""


@dataclass(frozen=True)
class Shown:
    """A table: what its rows are called, and a number a column in each."""

    caption: str
    keys: tuple[str, ...]
    columns: tuple[Definition, ...]
    rows: tuple[tuple[tuple[str, ...], tuple[Number, ...]], ...]
    note: str = ""


def chosen_tables(long: pl.DataFrame, columns: Sequence[str]) -> list[Shown]:
    """The metrics that a suite prints, side by side; none: those that the paper reports, or all.

    Of a metric that several sets have, the one that the paper's value stands beside, else that of
    the last set.
    """
    reported = long.filter(pl.col("paper").is_not_null())
    rows = long["metric"].unique(maintain_order=True).to_list()
    names = columns or [name for name in rows if name in set(reported["metric"])] or rows
    labels = dict(long.select("metric", "metric_set").unique(maintain_order=True).rows())
    labels |= dict(reported.select("metric", "metric_set").rows())
    there = [name for name in names if name in labels]
    return [
        _table("", long, [(labels[name], name) for name in part])
        for part in blocks(there, SIDE_BY_SIDE + 1)
    ]


def all_tables(long: pl.DataFrame) -> list[Shown]:
    """All metrics, in tables that fit a sheet of paper."""
    tables = []
    for label in long["metric_set"].unique(maintain_order=True):
        names = long.filter(metric_set=label)["metric"].unique(maintain_order=True).to_list()
        tables += [
            _table(label, long, [(label, name) for name in part])
            for part in blocks(names, SIDE_BY_SIDE)
        ]
    return tables


def _table(caption: str, long: pl.DataFrame, chosen: Sequence[tuple[str, str]]) -> Shown:
    """The cells of a run with some metrics, each of a metric set."""
    columns, defined = [], []
    for label, name in chosen:
        found = by_metric(long.filter(metric_set=label, metric=name))[name]
        columns.append((found, decimals_of(found.values())))
        defined.append(define_set(label).get(name) or unknown(label, name))
    cells = cells_of(long)
    with_agent = len({agent for agent, _ in cells}) > 1
    with_traffic = len({traffic for _, traffic in cells}) > 1 or not with_agent
    return Shown(
        caption=caption or " and ".join(dict.fromkeys(label for label, _ in chosen)),
        keys=("agent",) * with_agent + ("traffic",) * with_traffic,
        columns=tuple(defined),
        rows=tuple(
            (
                (agent,) * with_agent + (traffic,) * with_traffic,
                tuple(number(found.get((agent, traffic), {}), d) for found, d in columns),
            )
            for agent, traffic in cells
        ),
    )


def number(row: Mapping[str, Any], decimals: int, sign: str = "") -> Number:
    """A number from a row of a long table; an empty row is one that is not defined."""
    value, low, high, paper = (row.get(key) for key in ("value", "low", "high", "paper"))
    difference = None if value is None or paper is None else value - paper
    return Number(
        text=_text(value, decimals, sign),
        value=value,
        interval=_interval(low, high, decimals),
        paper="" if paper is None else _text(paper, decimals),
        difference="" if difference is None else _text(difference, decimals, "+"),
        n="" if row.get("n") is None else f"{row['n']:,}",
    )


def _text(value: float | None, decimals: int, sign: str = "") -> str:
    """A number with a minus that is one, and commas where it is long."""
    if value is not None and decimals == 0 and abs(value) >= 10_000:
        return f"{value:{sign},.0f}"
    return written(value, decimals, sign).replace("-", "−")


def _interval(low: float | None, high: float | None, decimals: int) -> str:
    if low is None or high is None:
        return ""
    dash = " to " if low < 0 else "–"
    return f"{_text(low, decimals)}{dash}{_text(high, decimals)}"


def realism_tables(long: pl.DataFrame, definitions: Mapping[str, Definition]) -> list[Shown]:
    """A table a reference and quantity: how far each traffic is from people."""
    tables = []
    for (reference, quantity), rows in long.with_columns(
        quantity=pl.col("metric").str.split("_").list.last()
    ).group_by("reference", "quantity", maintain_order=True):
        names = rows["metric"].unique(maintain_order=True).to_list()
        nearest = dict(rows.group_by("metric").agg(pl.col("value").min()).iter_rows())
        found = {(row["traffic"], row["metric"]): row for row in rows.iter_rows(named=True)}
        tables.append(
            Shown(
                caption=f"{reference}: {quantity}",
                keys=("traffic",),
                columns=tuple(definitions[name] for name in names),
                rows=tuple(
                    (
                        (traffic,),
                        tuple(_nearest(found[traffic, name], nearest[name]) for name in names),
                    )
                    for traffic in rows["traffic"].unique(maintain_order=True)
                ),
                note="★ nearest to people",
            )
        )
    return tables


def _nearest(row: Mapping[str, Any], least: float | None) -> Number:
    return replace(number(row, 3), strong=row["value"] is not None and row["value"] == least)


def pairs_table(pairs: pl.DataFrame, definitions: Mapping[str, Definition]) -> Shown:
    """A row a pair of egos: their differences."""
    names = pairs["metric"].unique(maintain_order=True).to_list()
    found = {
        (row["first"], row["second"], row["metric"]): row for row in pairs.iter_rows(named=True)
    }
    decimals = {
        name: decimals_of(
            {"value": row["difference"], "high": row["high"], "paper": None}
            for row in found.values()
            if row["metric"] == name
        )
        for name in names
    }
    return Shown(
        caption="Pair by pair",
        keys=("first", "second"),
        columns=tuple(definitions[name] for name in names),
        rows=tuple(
            (
                (first, second),
                tuple(_difference(found[first, second, name], decimals[name]) for name in names),
            )
            for first, second in pairs.select("first", "second").unique(maintain_order=True).rows()
        ),
        note="First less second. ★ separated from 0: p < 0.05, corrected over all pairs and "
        "metrics by Holm's method",
    )


def _difference(row: Mapping[str, Any], decimals: int) -> Number:
    plain = number({**row, "value": row["difference"]}, decimals, "+")
    return replace(plain, strong=bool(row["separated"]))


def stages_table(stages: pl.DataFrame) -> Shown:
    """A row a stage of a training: what its pipeline measured."""
    definitions = define_stages(stages.columns)
    measured = [name for name in stages.columns if stages[name].dtype.is_numeric()]
    decimals = {
        name: decimals_of({"value": value, "high": None, "paper": None} for value in stages[name])
        for name in measured
    }
    return Shown(
        caption="Stages",
        keys=("stage",),
        columns=tuple(definitions[name] for name in measured),
        rows=tuple(
            (
                (row["stage"],),
                tuple(number({"value": row[name]}, decimals[name]) for name in measured),
            )
            for row in stages.iter_rows(named=True)
        ),
    )
