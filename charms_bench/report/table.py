"""The table model: every table of a report is a `Table`, which is data until a view draws it.

Views: `terminal`, `bars`, `markdown`, `html.table`, and `Table.frame` for programs.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from typing import Any

import polars as pl

import charms_bench.report as views
from charms_bench.errors import ALL_METRICS, InputError, suggestion
from charms_bench.foundation.words import counted
from charms_bench.metrics.labels import in_words, key_label_of, set_label_of
from charms_bench.report.number import Cell, Number

LONG = {
    name: name
    for name in ("group", "name", "value", "low", "high", "n", "reference", "p", "marked")
}
"""The columns of a long frame after the keys, each with the part of a number that it holds."""
ESTIMATE = {name: name for name in ("value", "low", "high", "n")}
"""The parts of a number with its interval, by the columns of a long frame with the same names."""
DIGITS = 6
"""Significant digits kept: more than intervals warrant, fewer than the order of a sum disturbs."""
_TYPES: dict[str, pl.DataType] = {
    "group": pl.String(),
    "name": pl.String(),
    "n": pl.Int64(),
    "marked": pl.Boolean(),
}


def long_schema(keys: Sequence[str], long: Mapping[str, str]) -> dict[str, pl.DataType]:
    """The columns of a long frame with these keys and parts of numbers."""
    types = {name: _TYPES.get(part, pl.Float64()) for name, part in long.items()}
    return {**dict.fromkeys(keys, pl.String()), **types}


def long_frame(
    records: Iterable[Sequence[object]], keys: Sequence[str], long: Mapping[str, str]
) -> pl.DataFrame:
    """Records as a long frame: values are rounded to `DIGITS`, and NaN is null."""
    frame = pl.DataFrame(records, schema=long_schema(keys, long), orient="row")
    rounded = pl.col("value", "low", "high").fill_nan(None).round_sig_figs(DIGITS)
    return frame.with_columns(rounded)


def check_metrics(names: Iterable[str], known: Mapping[str, object]) -> None:
    """Raises an `InputError` if one of the names is not a known metric's."""
    for name in names:
        if name not in known:
            raise InputError(f"no metric named '{name}'. {suggestion(name, known, ALL_METRICS)}")


@dataclass(frozen=True)
class Column:
    """What the numbers of a column are."""

    name: str
    unit: str = ""
    """Empty for a proportion."""
    definition: str = ""
    counted: str = ""
    """What `Number.n` counts."""
    interval: str = ""
    """How the 95 % interval is computed."""
    group: str = ""
    """Where the column belongs: the label of a metric set, or the name of a reference."""
    quantity: str = ""
    """What is measured, where a group has columns of several quantities."""
    form: str = ""
    """How numbers are written: a format specification such as `.1%`; `%` for percentages with three
    digits of the column's largest; `margin` for two digits of the half-width of the interval, and
    `margin%` for the same of percentages; `p` for p-values; empty for four digits of the column's
    largest."""
    signed: bool = False
    """Whether the numbers are differences, which are written with their sign."""
    label: str = ""
    """The heading in views; if empty, it has the words of the name."""

    @property
    def heading(self) -> str:
        """What a view calls the column, without its unit."""
        return self.label or in_words(self.name)

    @property
    def heading_unit(self) -> str:
        """The unit beside the heading; a rate's heading says it itself."""
        return "" if self.unit.startswith("1/") else self.unit

    @property
    def title(self) -> str:
        """What a view calls the column, with its unit: `Mean speed (m/s)`."""
        return self.heading + (f" ({self.heading_unit})" if self.heading_unit else "")


@dataclass(frozen=True)
class Row:
    """The labels of a row, one per key, and its cells, one per column."""

    labels: tuple[str, ...]
    cells: tuple[Cell, ...]

    @property
    def numbers(self) -> list[Number]:
        """The cells as numbers; a text counts as one that is not defined."""
        return [cell if isinstance(cell, Number) else Number() for cell in self.cells]


@dataclass(frozen=True)
class Table:
    """Labelled rows of numbers."""

    name: str
    """The name of its files, without the ending."""
    title: str
    keys: tuple[str, ...]
    """What the labels of a row are, such as `agent` and `traffic`."""
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    note: str = ""
    reference: str = ""
    """Where reference values come from, such as `paper`."""
    long: Mapping[str, str] = field(default_factory=lambda: LONG)
    """The columns of `frame` after the keys, each with the part of a number that it holds."""

    @classmethod
    def from_frame(
        cls,
        frame: pl.DataFrame,
        name: str,
        title: str,
        keys: tuple[str, ...],
        long: Mapping[str, str],
        define: Callable[[str, str], Column],
        **more: Any,
    ) -> "Table":
        """The table of a long frame, in the order of its rows; the inverse of `frame`.

        The frame has one number per row, with the columns `keys` and `long`; `define` makes a
        column from its group and name. The other arguments are fields of the table.
        """
        columns: dict[tuple[str, str], None] = {}
        rows: dict[tuple[str, ...], dict[tuple[str, str], Number]] = {}
        for record in frame.iter_rows(named=True):
            parts = {part: record[column] for column, part in long.items()}
            column = (str(parts.pop("group", None) or ""), str(parts.pop("name") or ""))
            columns.setdefault(column)
            labels = tuple(str(record[key] or "") for key in keys)
            rows.setdefault(labels, {})[column] = Number(**parts)
        made = tuple(
            Row(labels, tuple(cells.get(column, Number()) for column in columns))
            for labels, cells in rows.items()
        )
        defined = tuple(define(*column) for column in columns)
        return cls(name, title, keys, defined, made, long=long, **more)

    @classmethod
    def from_records(
        cls,
        records: Iterable[Mapping[str, Any]],
        name: str,
        title: str,
        keys: tuple[str, ...],
        columns: tuple[Column, ...],
        note: str = "",
    ) -> "Table":
        """The table of some records: a cell that is not a `Number` yet becomes one, or a text."""

        def cell(value: object) -> Cell:
            if value is None or isinstance(value, int | float):
                return Number(value)
            return value if isinstance(value, Number) else str(value)

        rows = []
        for record in records:
            cells = tuple(cell(record.get(column.name)) for column in columns)
            rows.append(Row(tuple(str(record[key]) for key in keys), cells))
        return cls(name, title, keys, columns, tuple(rows), note)

    @classmethod
    def plain(
        cls, records: Iterable[Mapping[str, Any]], keys: tuple[str, ...], forms: Mapping[str, str]
    ) -> "Table":
        """The table of some records with neither name nor title; `forms` are those of columns."""
        columns = tuple(Column(name, form=form) for name, form in forms.items())
        return cls.from_records(records, "", "", keys, columns)

    def frame(self) -> pl.DataFrame:
        """The numbers as a long frame: row by row, but quantity by quantity if there are some."""
        by_quantity = any(column.quantity for column in self.columns)
        records = []
        for places in self._parts().values() if by_quantity else [range(len(self.columns))]:
            for row, i in product(self.rows, places):
                if isinstance(number := row.cells[i], Number):
                    known = {**vars(self.columns[i]), **vars(number)}
                    records.append([*row.labels, *(known[part] for part in self.long.values())])
        return pl.DataFrame(records, schema=long_schema(self.keys, self.long), orient="row")

    def records(self) -> list[dict[str, Any]]:
        """A dictionary per row: its labels, and the values of its columns."""
        names = [*self.keys, *(column.name for column in self.columns)]
        values = (
            [*row.labels, *(getattr(cell, "value", cell) for cell in row.cells)]
            for row in self.rows
        )
        return [dict(zip(names, each, strict=True)) for each in values]

    def select(self, *names: str) -> "Table":
        """The table with only these columns, group by group in this order.

        Raises:
            InputError: No column has such a name.
        """
        places = {(column.group, column.name): i for i, column in enumerate(self.columns)}
        check_metrics(names, {name: None for _, name in places})
        groups = dict.fromkeys(group for group, _ in places)
        chosen = [(group, name) for group in groups for name in names if (group, name) in places]
        return self.take([places[each] for each in chosen])

    def take(self, places: Sequence[int]) -> "Table":
        """The table with only the columns at these places, in this order."""
        columns = tuple(self.columns[i] for i in places)
        rows = (replace(row, cells=tuple(row.cells[i] for i in places)) for row in self.rows)
        return replace(self, columns=columns, rows=tuple(rows))

    def named(self, *names: str) -> "Table":
        """The table with these names of its columns, which are also their headings."""
        pairs = zip(self.columns, names, strict=True)
        renamed = (replace(each, name=name, label=name, unit="") for each, name in pairs)
        return replace(self, columns=tuple(renamed))

    def without_groups(self) -> "Table":
        """The table as one part, whatever groups its columns belong to."""
        columns = (replace(each, group="", quantity="") for each in self.columns)
        return replace(self, columns=tuple(columns))

    def parts(self) -> list["Table"]:
        """A table for each group and quantity, titled by them, with their columns."""
        parts = self._parts()
        if len(parts) == 1 and not self.columns[0].group:
            return [self]
        titles = ((set_label_of(group), key_label_of(quantity)) for group, quantity in parts)
        return [
            replace(self.take(places), title=": ".join(filter(None, title)))
            for title, places in zip(titles, parts.values(), strict=True)
        ]

    def _parts(self) -> dict[tuple[str, str], list[int]]:
        """The places of the columns of each group and quantity."""
        places: dict[tuple[str, str], list[int]] = {}
        for i, column in enumerate(self.columns):
            places.setdefault((column.group, column.quantity), []).append(i)
        return places

    def blocks(self, most: int) -> list["Table"]:
        """The columns in tables of about the same number of them, at most this many."""
        count = max(1, math.ceil(len(self.columns) / most))
        ends = [i * len(self.columns) // count for i in range(count + 1)]
        return [self.take(range(start, end)) for start, end in pairwise(ends)]

    def without_constant_keys(self) -> "Table":
        """The table without keys whose labels are all the same; at least one key stays."""
        by_key = zip(*(row.labels for row in self.rows), strict=True)
        kept = [i for i, labels in enumerate(by_key) if len(set(labels)) > 1] or [0]
        rows = tuple(replace(row, labels=tuple(row.labels[i] for i in kept)) for row in self.rows)
        return replace(self, keys=tuple(self.keys[i] for i in kept), rows=rows)

    def column(self, place: int) -> list[Number]:
        """The numbers of the column at this place."""
        return [row.numbers[place] for row in self.rows]

    def reported(self) -> list[int]:
        """The places of the columns with reference values."""
        known = [[number.reference is not None for number in row.numbers] for row in self.rows]
        return [i for i in range(len(self.columns)) if any(row[i] for row in known)]

    def places(self, *names: str) -> list[int] | None:
        """The places of these columns, the last of each name; None if one is missing or empty."""
        last = {column.name: i for i, column in enumerate(self.columns)}
        found = [last[name] for name in names if name in last]
        defined = [any(number.value is not None for number in self.column(i)) for i in found]
        return found if len(found) == len(names) and all(defined) else None

    def __repr__(self) -> str:
        rows, columns = counted(len(self.rows), "row"), counted(len(self.columns), "column")
        return f"<Table {self.name}: {rows} x {columns}>"

    def __str__(self) -> str:
        """The beginning of the table as text; `select` and `frame` give the rest."""
        from charms_bench.report.terminal import beginning

        return beginning(self)

    def _repr_html_(self) -> str:
        """The table for a notebook."""
        return views.notebook_of(self)
