"""The tables of a training: its stages, and their learning curves.

Any pipeline can write them into its run folder: `stages.csv` has one row per stage, `curves.csv`
one row per stage and point, in the order in which they were learnt, and `columns.json` says what
their columns are (`ColumnsFile`). Without `columns.json`, the names of the columns stand alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import polars as pl
from pydantic import Field, ValidationError
from rich.console import Group
from rich.table import Table as RichTable
from rich.text import Text

from charms_bench.errors import RunFolderError
from charms_bench.report.bars import Scale, line
from charms_bench.report.stored import holds, read_csv, read_file
from charms_bench.report.table import Column, Table
from charms_bench.report.terminal import WIDEST
from charms_bench.world.fields import FrozenModel, Line

STAGES, CURVES, COLUMNS = "stages.csv", "curves.csv", "columns.json"
Form = Annotated[str, Field(pattern=r"^(,?\.\d[fg%])?$")]


class StageColumn(FrozenModel):
    """What a column of `stages.csv` is."""

    unit: Line = ""
    definition: Line = ""
    form: Form = ""
    """A format specification, such as `.1%`."""


class CurveColumn(FrozenModel):
    """What a column of `curves.csv` is, which is drawn as a learning curve."""

    over: Line
    """The column that it is drawn over, such as `steps`."""
    title: Line
    form: Form = ""


class ColumnsFile(FrozenModel):
    """The content of `columns.json`: columns by name."""

    stages: Mapping[Line, StageColumn] = {}
    curves: Mapping[Line, CurveColumn] = {}


@dataclass(frozen=True)
class Curve:
    """One learning curve per stage, of one quantity."""

    title: str
    over: str
    column: str
    form: str
    points: pl.DataFrame
    """The rows of `curves.csv` that have both `over` and `column`."""


@dataclass(frozen=True)
class Training:
    """The run folder of a training: its stages and their learning curves."""

    path: Path

    stages: Table | None
    curves: pl.DataFrame | None
    """One row per `stage` and point."""
    columns: ColumnsFile

    def to_dict(self) -> dict[str, Any]:
        """Stages and curves as records, for JSON; those that the folder has."""
        found = {
            "stages": None if self.stages is None else self.stages.records(),
            "curves": None if self.curves is None else self.curves.to_dicts(),
        }
        return {name: records for name, records in found.items() if records is not None}

    def _repr_html_(self) -> str | None:
        return None if self.stages is None else self.stages._repr_html_()

    def drawn(self) -> list[Curve]:
        """The curves that can be drawn, in the order in which `columns.json` has them."""
        if self.curves is None:
            return []
        curves = self.curves.with_columns(point=pl.int_range(pl.len()).over("stage"))
        numeric = [name for name in curves.columns if curves.schema[name].is_numeric()]
        described = self.columns.curves or {
            name: CurveColumn(over="point", title=name) for name in numeric if name != "point"
        }
        return [
            Curve(each.title, each.over, name, each.form, points)
            for name, each in described.items()
            if {name, each.over} <= set(numeric)
            and len(points := curves.drop_nulls([each.over, name]))
        ]


def stored_training(folder: Path) -> Training:
    """The tables of a training, those that its run folder has.

    Raises:
        RunFolderError: One cannot be read, or does not say which stage a row belongs to.
    """
    columns = ColumnsFile()
    if holds(folder, COLUMNS):
        try:
            columns = ColumnsFile.model_validate_json(read_file(folder / COLUMNS))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise RunFolderError(f"{folder / COLUMNS}: {where}: {first['msg']}") from error
    found = {}
    for path in (folder / name for name in (STAGES, CURVES) if holds(folder, name)):
        found[path.name] = read_csv(path)
        if "stage" not in found[path.name].columns:
            names = ", ".join(found[path.name].columns)
            raise RunFolderError(f"{path}: expected a column 'stage', found {names}")
    stages = stages_table(found[STAGES], columns.stages) if STAGES in found else None
    return Training(folder, stages, found.get(CURVES), columns)


def stages_table(stages: pl.DataFrame, described: Mapping[str, StageColumn]) -> Table:
    """The table of `stages.csv`."""
    columns = tuple(
        Column(name, each.unit, each.definition, form=each.form)
        for name in stages.columns
        if name != "stage"
        for each in [described.get(name, StageColumn(definition="As the pipeline calls it"))]
    )
    rows = stages.iter_rows(named=True)
    return Table.from_records(rows, "stages", "Stages", ("stage",), columns)


def drawn_curves(training: Training, width: int = 100) -> Group:
    """The learning curves for a terminal, one line per stage, all of a quantity on one scale."""
    parts: list[Text | RichTable] = []
    for curve in training.drawn():
        parts += [Text(f"\n{curve.title}", style="bold"), _drawn(curve, width)]
    return Group(*parts)


def _drawn(curve: Curve, width: int) -> RichTable:
    stages = curve.points["stage"].unique(maintain_order=True).to_list()
    longest = max(len(str(stage)) for stage in stages)
    scale = Scale.over(curve.points[curve.column], min(WIDEST, max(10, width - longest - 24)))
    table = RichTable(box=None, padding=(0, 2, 0, 0))
    table.add_column("stage", no_wrap=True)
    table.add_column("first", justify="right", no_wrap=True)
    table.add_column(f"{scale.low:.3g} to {scale.high:.3g}", no_wrap=True)
    table.add_column("last", justify="right", no_wrap=True)
    for stage in stages:
        values = curve.points.filter(stage=stage)[curve.column].to_list()
        picture = Text(line(scale, values), style="cyan")
        table.add_row(Text(str(stage)), f"{values[0]:.3g}", picture, f"{values[-1]:.3g}")
    return table
