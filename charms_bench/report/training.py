"""A training's stored tables for a terminal: its stages, and their learning curves.

Whatever pipeline trained: a run folder has `stages.csv`, a row a stage, and `curves.csv`, a row a
stage and point, in the order in which they were learnt.
"""

from collections.abc import Mapping
from pathlib import Path

import polars as pl
from rich.console import Group
from rich.table import Table
from rich.text import Text

from charms_bench.errors import RunFolderError
from charms_bench.report.bars import Scale, line
from charms_bench.report.stored import holds, read_csv

STAGES, CURVES = "stages.csv", "curves.csv"
WIDEST = 44
DRAWN = {
    "return_mean": "return of an episode",
    "crashed_share": "share of episodes crashed",
    "agreement": "agreement with people",
}
"""Columns of the curves that are drawn, and what they are."""


def stored_training(folder: Path) -> dict[str, pl.DataFrame]:
    """The tables `stages` and `curves`, those that there are.

    Raises:
        RunFolderError: One cannot be read, or does not say of which stage a row is.
    """
    tables = {}
    for name in (STAGES, CURVES):
        if not holds(folder, name):
            continue
        path = folder / name
        table = read_csv(path)
        if "stage" not in table.columns:
            found = ", ".join(table.columns)
            raise RunFolderError(f"{path}: expected a column 'stage', found {found}")
        tables[path.stem] = table
    return tables


def render(tables: Mapping[str, pl.DataFrame], width: int = 100) -> Group:
    """The stages, then a curve a stage for everything that was measured while it learnt."""
    parts: list[Text | Table] = []
    if "stages" in tables:
        parts.append(render_stages(tables["stages"]))
    if "curves" in tables:
        curves = tables["curves"]
        for column, what in DRAWN.items():
            if column in curves.columns and curves.schema[column].is_numeric():
                drawn = curves.drop_nulls(column)
                parts += [Text(f"\n{what}", style="bold"), _curves(drawn, column, width)]
    return Group(*parts)


def render_stages(stages: pl.DataFrame) -> Table:
    """A row a stage: how long it took, and what came of it."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("stage", no_wrap=True)
    for column in ("time", "steps/s", "return", "crashed", "agreement"):
        table.add_column(column, justify="right", no_wrap=True)
    for row in stages.iter_rows(named=True):
        agrees = [row.get("agreement_before"), row.get("agreement")]
        table.add_row(
            Text(str(row["stage"])),
            _number(_part(row.get("wall_s"), 60), ".1f", " min"),
            _number(row.get("steps_per_s"), ",.0f"),
            _number(row.get("return"), ".1f"),
            _number(row.get("crashed"), ".0%"),
            " → ".join(_number(share, ".1%") for share in agrees if share is not None),
        )
    return table


def _curves(curves: pl.DataFrame, column: str, width: int) -> Table:
    """A curve a stage, all on one scale."""
    stages = curves["stage"].unique(maintain_order=True).to_list()
    longest = max((len(str(stage)) for stage in stages), default=0)
    scale = Scale.over(curves[column], min(WIDEST, max(10, width - longest - 24)))
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("stage", no_wrap=True)
    table.add_column("first", justify="right", no_wrap=True)
    table.add_column(f"{scale.low:.3g} to {scale.high:.3g}", no_wrap=True)
    table.add_column("last", justify="right", no_wrap=True)
    for stage in stages:
        values = curves.filter(stage=stage)[column].to_list()
        drawn = Text(line(scale, values), style="cyan")
        table.add_row(Text(str(stage)), f"{values[0]:.3g}", drawn, f"{values[-1]:.3g}")
    return table


def _part(number: float | None, whole: float) -> float | None:
    return None if number is None else number / whole


def _number(number: float | None, form: str, unit: str = "") -> str:
    return "" if number is None else f"{number:{form}}{unit}"
