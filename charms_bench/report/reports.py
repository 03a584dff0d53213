"""Everything that is written of a run: which tables and figures its suite calls for."""

from collections.abc import Sequence
from pathlib import Path

import polars as pl

from charms_bench.people.reference import Reference
from charms_bench.report.matrix import write_matrices
from charms_bench.report.pairs import write_pairs
from charms_bench.report.realism import build_realism, write_realism
from charms_bench.report.realism_figures import draw_realism
from charms_bench.report.tables import build_table, write_tables
from charms_bench.report.tradeoff import OF_EGOS, OF_TRAFFICS, write_tradeoff
from charms_bench.runs.cells import CellRows, TrafficCounts
from charms_bench.runs.suite import Suite


def write_reports(
    suite: Suite,
    folder: Path,
    cells: Sequence[CellRows],
    following: Sequence[TrafficCounts],
    references: Sequence[Reference],
) -> tuple[pl.DataFrame, dict[str, list[Path]]]:
    """Writes tables and figures into a run folder.

    Args:
        suite: What was run.
        folder: The run folder.
        cells: The rows of its cells.
        following: What all vehicles of its cells did while they followed.
        references: The human driving to hold that against.

    Returns:
        The long table (`tables.LONG_SCHEMA`), and the files for people, by what they are.
    """
    tables, figures, name = folder / "tables", folder / "figures", suite.suite
    table = build_table(cells, suite.scene, suite.seed)
    write_tables(tables, name, table)
    files = {"All metrics": [tables / f"{name}.md"]}
    if suite.pairs:
        write_pairs(tables, name, cells, suite.scene, suite.seed)
        files["Pair by pair"] = [tables / f"{name}-pairs.md"]
    if len(cells) > 1:
        tradeoff = figures / f"{name}-tradeoff.png"
        write_tradeoff(tradeoff, table, OF_EGOS if len(suite.egos) > 1 else OF_TRAFFICS)
        files["Trade-off"] = [tradeoff]
    if len(suite.egos) > 1 and len(suite.traffics) > 1:
        markdown, figure = tables / f"{name}-matrix.md", figures / f"{name}-matrix.png"
        write_matrices(markdown, figure, table)
        files["Matrices"] = [markdown, figure]
    if references:
        realism = build_realism(following, references, suite.seed)
        write_realism(tables, name, realism, references)
        drawn = draw_realism(figures, name, following, references)
        files["Realism"] = [tables / f"{name}-realism.md", *drawn]
    return table, files
