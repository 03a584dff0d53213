"""Writes the tables and figures of a run into its folder."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import polars as pl

from charms_bench.foundation.files import write_bytes
from charms_bench.foundation.spreadsheets import in_csv
from charms_bench.humans.reference import Reference
from charms_bench.metrics import MetricSet
from charms_bench.report import drivers_table, suite_table
from charms_bench.report.figures.drawing import save
from charms_bench.report.figures.heat_map import draw_matrices
from charms_bench.report.figures.human_driving import draw_quantity, recorded
from charms_bench.report.figures.preventable import draw_preventable
from charms_bench.report.figures.tradeoff import draw_tradeoff, tradeoff_of
from charms_bench.report.markdown import document, markdown, without_html
from charms_bench.report.pairs_table import guess_summary, pairs_table
from charms_bench.report.preventable_table import preventable_table
from charms_bench.report.realism_table import TITLE, realism_table
from charms_bench.report.stored import SUMS, sums_in
from charms_bench.report.suite_table import matrices
from charms_bench.report.table import Table
from charms_bench.runs.cells import CellRows, TrafficCounts
from charms_bench.runs.suite import Suite


@dataclass(frozen=True)
class MeasuredCell:
    """A cell, and its parts of the tables that take longest to compute."""

    rows: CellRows
    metrics: pl.DataFrame
    """Its part of `suite_table`."""
    drivers: pl.DataFrame
    """Its part of `drivers_table`."""


def measure(suite: Suite, rows: CellRows, metric_sets: Sequence[MetricSet] = ()) -> MeasuredCell:
    """Computes what can be computed of one cell before the others are finished.

    By default, the metric sets are the suite's.
    """
    read = replace(rows, drivers=tuple(rows.drivers))  # once for both tables
    metrics = suite_table.part_of(suite, read, metric_sets or suite.metric_sets)
    return MeasuredCell(rows, metrics, drivers_table.part_of(suite, read))


def write_run(
    suite: Suite,
    folder: Path,
    cells: Sequence[MeasuredCell],
    following: Sequence[TrafficCounts],
    references: Sequence[Reference],
) -> None:
    """Writes the tables and figures that a suite calls for into a run folder.

    `following` is what all vehicles of its cells did while they followed; it and `references`,
    human driving to compare with, are for the table of realism.
    """
    tables = run_tables(suite, cells, following, references)
    for table, introduction in tables:
        write_table(folder, table, introduction)
    table, figures, name = tables[0][0], folder / "figures", suite.suite
    rows = [cell.rows for cell in cells]
    if suite.preventable_by and (figure := draw_preventable(suite, rows)):
        save(figure, figures / f"{name}-preventable.png")
    if len(cells) > 1:
        save(draw_tradeoff(table, tradeoff_of(suite)), figures / f"{name}-tradeoff.png")
    if matrix := matrices(table):
        write_files(folder, {f"{name}-matrix.md": matrix_page(matrix)})
        save(draw_matrices(matrix), figures / f"{name}-matrix.png")
    if references:
        for quantity in TITLE:
            if people := recorded(quantity, references):
                path = figures / f"{name}-{quantity}.png"
                save(draw_quantity(quantity, following, people), path)


def run_tables(
    suite: Suite,
    cells: Sequence[MeasuredCell],
    following: Sequence[TrafficCounts],
    references: Sequence[Reference],
    metric_sets: Sequence[MetricSet] = (),
) -> list[tuple[Table, Sequence[str]]]:
    """The tables that a suite calls for, the one of metrics first, each with its introduction.

    `metric_sets` are those that the cells were measured with; by default, the suite's.
    """
    metric_sets = metric_sets or suite.metric_sets
    metrics = pl.concat(cell.metrics for cell in cells)
    drivers = pl.concat(cell.drivers for cell in cells)
    made: list[tuple[Table, Sequence[str]]] = [
        (suite_table.from_frame(metrics, suite, metric_sets), ()),
        (drivers_table.from_frame(drivers, suite), ()),
    ]
    rows = [cell.rows for cell in cells]
    if suite.pairs and len(cells) > 1:
        pairs = pairs_table(suite, rows)
        apart = sum(any(cell.marked for cell in row.numbers) for row in pairs.rows)
        differ = f"{apart} of {len(pairs.rows)} pairs differ in at least one metric."
        made.append((pairs, [differ, guess_summary(suite, rows)]))
    if suite.preventable_by and (preventable := preventable_table(suite, rows)).rows:
        made.append((preventable, ()))
    if references:
        realism = realism_table(suite, following, references)
        made.append((realism, [_described(each) for each in references]))
    return made


def matrix_page(matrix: Sequence[Table]) -> bytes:
    """The matrices of a suite as a Markdown file."""
    parts = []
    for each in matrix:
        # Without separators of thousands, as in folders that were written before views had them.
        columns = tuple(replace(column, form=".1f") for column in each.columns)
        parts.append(f"## {without_html(each.title)}\n\n{markdown(replace(each, columns=columns))}")
    return "\n".join(parts).encode()


def write_table(folder: Path, table: Table, introduction: Sequence[str] = ()) -> Path:
    """Writes a table into a run folder, as CSV and as Markdown; returns the path of the latter."""
    write_files(folder, table_files(table, introduction))
    return folder / "tables" / f"{table.name}.md"


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Writes files, by name, into the folder `tables` of a run, and their checksums."""
    tables = folder / "tables"
    for name, data in files.items():
        write_bytes(tables / name, data)
    new = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    lines = (f"{sha256}  {name}\n" for name, sha256 in sorted((sums_in(tables) | new).items()))
    write_bytes(tables / SUMS, "".join(lines).encode())


def table_files(table: Table, introduction: Sequence[str] = ()) -> dict[str, bytes]:
    """The files of a table, by name."""
    return {
        f"{table.name}.csv": in_csv(table.frame()),
        f"{table.name}.md": document(table, introduction).encode(),
    }


def _described(reference: Reference) -> str:
    """Where a reference comes from, and what it measures."""
    lines = [f"**{reference.name}**: {reference.origin} Data: {reference.terms}."]
    for quantity, what in (("speed", reference.speed_is), ("dhw", reference.dhw_is)):
        units = reference.units(quantity)
        if len(units):
            lines.append(
                f"- {TITLE[quantity]}: {what}. Human driving: n = {units.sum():,.0f}; vehicles: "
                f"{reference.vehicles:,}. Independent of each other: {len(units):,} "
                f"{reference.unit}{'s' * (len(units) > 1)}."
            )
    return "\n".join(lines)
