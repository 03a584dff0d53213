"""A run's tables: one number a row for programs, one cell a row for people."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from charms_bench.metrics import METRIC_SETS, PAPER, MetricSet, sums_by_episode
from charms_bench.runs.cells import CellRows
from charms_bench.statistics.intervals import estimate
from charms_bench.world.files import write_atomically
from charms_bench.world.scene import SceneSettings

LONG_SCHEMA: dict[str, pl.DataType] = {
    "agent": pl.String(),
    "traffic": pl.String(),
    "metric_set": pl.String(),  # with its version, such as paper-1
    "metric": pl.String(),
    "value": pl.Float64(),  # null where it is not defined
    "low": pl.Float64(),  # of the 95 % interval
    "high": pl.Float64(),
    "n": pl.Int64(),  # what it rests on; `Metric.rests_on` says what that is
    "paper": pl.Float64(),
}
DIGITS = 6
"""Significant digits kept: more than intervals warrant, fewer than the order of a sum disturbs."""
METRIC_WIDTH = 15
"""Characters a metric needs in the terminal: its interval and the space around it."""
NOTHING = "–"

Row = Mapping[str, float | None]


def build_table(
    cells: Iterable[CellRows],
    settings: SceneSettings,
    seed: int,
    metric_sets: Sequence[MetricSet] = METRIC_SETS,
) -> pl.DataFrame:
    """The long table of a run, by cell, metric set and metric (`LONG_SCHEMA`).

    Args:
        cells: In the order of the table.
        settings: What their scenes have in common.
        seed: Of the resamples, which are the same for cells of as many episodes.
        metric_sets: What is measured.
    """
    metrics = [metric for metric_set in metric_sets for metric in metric_set.metrics]
    labels = [metric_set.label for metric_set in metric_sets for _ in metric_set.metrics]
    rows = []
    for cell in cells:
        sums = sums_by_episode(metrics, cell.episodes, cell.steps, settings)
        estimates = estimate(metrics, sums, np.random.default_rng(seed))
        rows += [
            {
                "agent": cell.agent,
                "traffic": cell.traffic,
                "metric_set": label,
                "metric": metric.name,
                "value": result.value,
                "low": result.low,
                "high": result.high,
                "n": result.n,
                "paper": cell.paper.get(metric.name) if label == PAPER.label else None,
            }
            for metric, label, result in zip(metrics, labels, estimates, strict=True)
        ]
    numbers = pl.col("value", "low", "high")
    table = pl.DataFrame(rows, schema=LONG_SCHEMA)
    return table.with_columns(numbers.fill_nan(None).round_sig_figs(DIGITS))


def write_tables(
    folder: Path, name: str, long: pl.DataFrame, metric_sets: Sequence[MetricSet] = METRIC_SETS
) -> None:
    """Writes `<name>.csv`, the long table, and `<name>.md`, for reading, into a folder."""
    write_atomically(folder / f"{name}.csv", long.write_csv)
    text = render_markdown(long, metric_sets)
    write_atomically(folder / f"{name}.md", lambda path: path.write_bytes(text.encode()))


def render_markdown(long: pl.DataFrame, metric_sets: Sequence[MetricSet] = METRIC_SETS) -> str:
    """A table a metric set, a cell a row; beneath it what the metrics are."""
    parts = [f"Values with 95 % intervals; {NOTHING} where there is none."]
    for metric_set in metric_sets:
        columns = by_metric(long.filter(metric_set=metric_set.label))
        header, body = ["agent", "traffic"], [list(cell) for cell in cells_of(long)]
        for metric, column in columns.items():
            decimals = decimals_of(column.values())
            compared = any(row["paper"] is not None for row in column.values())
            header += [metric, "paper (difference)"] if compared else [metric]
            for line in body:
                row = column.get((line[0], line[1]), {})
                line.append(_with_interval(row, decimals))
                if compared:
                    line.append(_with_difference(row, decimals))
        rule = ["---", "---"] + ["---:"] * (len(header) - 2)
        lines = ["| " + " | ".join(map(_escaped, line)) + " |" for line in (header, rule, *body)]
        legend = [
            f"- `{metric.name}`{f' ({metric.unit})' if metric.unit else ''}: "
            f"{metric.description}. n: {metric.rests_on}."
            for metric in metric_set.metrics
            if metric.name in columns
        ]
        parts.append("\n".join([f"## {metric_set.label}", "", *lines, "", *legend]))
    return "\n\n".join(parts) + "\n"


def render_terminal(long: pl.DataFrame, columns: Sequence[str] = (), width: int = 100) -> Group:
    """The long table for a terminal, as many metrics side by side as fit.

    Args:
        long: The long table.
        columns: The metrics to show, from each set that has them; none: those that the paper
            reports, and if there are none, all.
        width: Of the terminal, in characters.
    """
    if not columns:
        reported = set(long.filter(pl.col("paper").is_not_null())["metric"])
        columns = [name for name in by_metric(long) if name in reported]
    cells = cells_of(long)
    shows_traffic = len({traffic for _, traffic in cells}) > 1
    shows_agent = not shows_traffic or len({agent for agent, _ in cells}) > 1
    labels = [len(agent) * shows_agent + len(traffic) * shows_traffic for agent, traffic in cells]
    side_by_side = max(1, (width - max(labels, default=0) - 6) // METRIC_WIDTH)
    tables = []
    for label in long["metric_set"].unique(maintain_order=True):
        shown = by_metric(long.filter(metric_set=label))
        for block in blocks([name for name in columns or shown if name in shown], side_by_side):
            table = Table(title=Text(label), title_justify="left", box=box.SIMPLE_HEAD)
            for header in ["agent"] * shows_agent + ["traffic"] * shows_traffic:
                table.add_column(header)
            for name in block:
                # Spaces wrap, underscores do not.
                table.add_column(name.replace("_", " "), justify="right")
            for agent, traffic in cells:
                names = [Text(agent)] * shows_agent + [Text(traffic)] * shows_traffic
                rows = [shown[name].get((agent, traffic), {}) for name in block]
                decimals = [decimals_of(shown[name].values()) for name in block]
                table.add_row(*names, *map(_stacked, rows, decimals))
            tables.append(table)
    return Group(*tables)


def blocks(names: list[str], side_by_side: int) -> list[list[str]]:
    """The names in blocks of about the same length, at most `side_by_side`."""
    count = math.ceil(len(names) / side_by_side)
    ends = [i * len(names) // max(count, 1) for i in range(count + 1)]
    return [names[start:end] for start, end in pairwise(ends)]


def cells_of(long: pl.DataFrame) -> list[tuple[str, str]]:
    """The cells, each an agent and a traffic."""
    return long.select("agent", "traffic").unique(maintain_order=True).rows()


def by_metric(long: pl.DataFrame) -> dict[str, dict[tuple[str, str], Row]]:
    """The rows by metric and cell."""
    columns: dict[str, dict[tuple[str, str], Row]] = {}
    for row in long.iter_rows(named=True):
        columns.setdefault(row["metric"], {})[row["agent"], row["traffic"]] = row
    return columns


def decimals_of(rows: Iterable[Row]) -> int:
    """Decimals for a column: four digits of its largest number, three of one below 1."""
    numbers = [row[key] for row in rows for key in ("value", "high", "paper")]
    largest = max((abs(number) for number in numbers if number is not None), default=0.0)
    magnitude = math.floor(math.log10(largest)) if largest else 0
    return min(5, 2 - magnitude) if magnitude < 0 else max(0, 3 - magnitude)


def written(number: float | None, decimals: int, sign: str = "") -> str:
    return NOTHING if number is None else f"{number:{sign}.{decimals}f}"


def _interval(row: Row, decimals: int) -> str:
    if row.get("low") is None:
        return ""
    return f"[{written(row['low'], decimals)}, {written(row['high'], decimals)}]"


def _with_interval(row: Row, decimals: int) -> str:
    return f"{written(row.get('value'), decimals)} {_interval(row, decimals)}".rstrip()


def _with_difference(row: Row, decimals: int) -> str:
    value, paper = row.get("value"), row.get("paper")
    if value is None or paper is None:
        return written(paper, decimals)
    return f"{written(paper, decimals)} ({written(value - paper, decimals, '+')})"


def _stacked(row: Row, decimals: int) -> Text:
    """The value, its interval under it, and the paper's value under that."""
    text = Text(written(row.get("value"), decimals), style="bold")
    if interval := _interval(row, decimals):
        text.append("\n" + interval.strip("[]").replace(", ", "–"), style="not bold dim")
    if (paper := row.get("paper")) is not None:
        text.append(f"\npaper {written(paper, decimals)}", style="not bold")
    return text


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")
