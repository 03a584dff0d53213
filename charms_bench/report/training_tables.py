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

from charms_bench.errors import RunFolderError, problem_in
from charms_bench.foundation.fields import FrozenModel, Line
from charms_bench.foundation.files import read_file
from charms_bench.report.bars import Scale, line
from charms_bench.report.stored import holds, read_csv
from charms_bench.report.table import Column, Table
from charms_bench.report.terminal import WIDEST
from charms_bench.runs.manifest import MANIFEST_LIMIT_BYTES

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
class Training:
    """The run folder of a training: its stages and their learning curves."""

    path: Path

    stages: Table | None
    curves: pl.DataFrame | None
    """One row per `stage` and point."""
    columns: ColumnsFile

    def __repr__(self) -> str:
        stages = 0 if self.stages is None else len(self.stages.rows)
        points = 0 if self.curves is None else self.curves.height
        return f"<Training {self.path}: {stages} stages, {points:,} points of learning curves>"

    def __str__(self) -> str:
        return repr(self) if self.stages is None else f"{self!r}\n{self.stages}"

    def to_dict(self) -> dict[str, Any]:
        """The stages and curves in the folder as records, for JSON."""
        stages = {} if self.stages is None else {"stages": self.stages.records()}
        return stages | ({} if self.curves is None else {"curves": self.curves.to_dicts()})

    def _repr_html_(self) -> str | None:
        return None if self.stages is None else self.stages._repr_html_()

    def drawn(self) -> list[tuple[str, CurveColumn, pl.DataFrame]]:
        """The curves that can be drawn, in the order in which `columns.json` has them.

        Each is the name of a column, what it is, and the rows that have it and what it is over.
        """
        if self.curves is None:
            return []
        curves = self.curves.with_columns(point=pl.int_range(pl.len()).over("stage"))
        numeric = [name for name in curves.columns if curves.schema[name].is_numeric()]
        described = self.columns.curves or {
            name: CurveColumn(over="point", title=name) for name in numeric if name != "point"
        }
        return [
            (name, each, points)
            for name, each in described.items()
            if {name, each.over} <= set(numeric)
            and len(points := curves.drop_nulls([each.over, name]))
        ]


def stored_training(folder: Path) -> Training:
    """The tables of a training, those that its run folder has.

    A `RunFolderError` if one cannot be read, or does not say which stage a row belongs to.
    """
    columns = ColumnsFile()
    if holds(folder, COLUMNS):
        try:
            columns = ColumnsFile.model_validate_json(
                read_file(folder / COLUMNS, MANIFEST_LIMIT_BYTES)
            )
        except ValidationError as error:
            raise RunFolderError(f"{folder / COLUMNS}: {problem_in(error)}") from error
    found = {name: read_csv(folder / name) for name in (STAGES, CURVES) if holds(folder, name)}
    for name, table in found.items():
        if "stage" not in table.columns:
            others = ", ".join(table.columns)
            raise RunFolderError(f"{folder / name}: expected a column 'stage', found {others}")
    stages = None
    if STAGES in found:
        unknown = StageColumn(definition="As the pipeline calls it")
        described = tuple(
            Column(name, **columns.stages.get(name, unknown).model_dump())
            for name in found[STAGES].drop("stage").columns
        )
        rows = found[STAGES].iter_rows(named=True)
        stages = Table.from_records(rows, "stages", "Stages", ("stage",), described)
    return Training(folder, stages, found.get(CURVES), columns)


def drawn_curves(training: Training, width: int = 100) -> Group:
    """The learning curves for a terminal, one line per stage, all of a quantity on one scale."""
    parts: list[Text | RichTable] = []
    for name, curve, points in training.drawn():
        curves = points.partition_by("stage", maintain_order=True)
        longest = max(len(str(each["stage"][0])) for each in curves)
        scale = Scale.over(points[name], min(WIDEST, max(10, width - longest - 24)))
        table = RichTable(box=None, padding=(0, 2, 0, 0))
        table.add_column("stage", no_wrap=True)
        table.add_column("first", justify="right", no_wrap=True)
        table.add_column(f"{scale.low:z.3g} to {scale.high:z.3g}", no_wrap=True)
        table.add_column("last", justify="right", no_wrap=True)
        for each in curves:
            values = each[name].to_list()
            picture = Text(line(scale, values), style="cyan")
            stage = Text(str(each["stage"][0]))
            table.add_row(stage, f"{values[0]:z.3g}", picture, f"{values[-1]:z.3g}")
        parts += [Text(f"\n{curve.title}", style="bold"), table]
    return Group(*parts)
