"""A table as HTML: in a page, linked to its definitions, or alone in a notebook."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from charms_bench.foundation.names import unused
from charms_bench.metrics.labels import key_label_of
from charms_bench.report.bars import Scale
from charms_bench.report.formatting import Written, write_cells
from charms_bench.report.number import Cell

if TYPE_CHECKING:
    from charms_bench.report.table import Column, Row, Table

TEMPLATES = Path(__file__).with_name("templates")


@cache
def environment() -> Environment:
    """The templates; names that are filled in are text, whatever they look like."""
    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"written": written, "scales": scales, "bar": bar, "key_label": key_label_of}
    return made


def written(table: Table) -> list[tuple[Row, list[Written]]]:
    """Each row with its cells as text; numbers have the minus sign of typography."""
    return [
        (row, list(map(_typeset, row.cells, texts)))
        for row, texts in zip(table.rows, write_cells(table), strict=True)
    ]


def scales(table: Table) -> list[Scale | None]:
    """The scale of each column's bars, in percent of their width; None without any interval.

    That of all proportions ends at 100 %, so that their bars compare.
    """
    found: list[Scale | None] = []
    for place, column in enumerate(table.columns):
        numbers = table.column(place)
        ends = [end for each in numbers for end in (each.value, each.low, each.high)]
        has_interval = any(each.low is not None for each in numbers)
        if column.form.endswith("%") and not column.signed:
            ends = [0.0, 1.0]
        scale = Scale.over(ends, 101, zero=column.signed)
        found.append(scale if has_interval else None)
    return found


def bar(cell: Cell, scale: Scale) -> Markup:
    """A value in its interval, drawn to scale; empty if either is not defined."""
    if isinstance(cell, str) or cell.value is None or cell.low is None or cell.high is None:
        return Markup("")
    low, value, high = map(scale.place, (cell.low, cell.value, cell.high))
    # Numbers alone are filled in: no text of a table reaches a style.
    return Markup(
        '<span class="bar" aria-hidden="true"><i style="left:{}%;right:{}%"></i>'
        '<em style="left:{}%"></em></span>'
    ).format(low, 100 - high, value)


def _typeset(cell: Cell, text: Written) -> Written:
    if isinstance(cell, str):
        return text
    fields = ("value", "low", "high", "reference", "difference")
    return replace(text, **{name: getattr(text, name).replace("-", "−") for name in fields})


def definition_ids(columns: Iterable[Column]) -> dict[Column, str]:
    """What links call the definition of each column; columns that say the same share one."""
    ids: dict[Column, str] = {}
    said: dict[Column, str] = {}
    for column in columns:
        same = replace(column, group="", quantity="", form="", label="", signed=False)
        if same not in said:
            found = re.sub(r"[^\w.-]", "_", f"is-{column.group}-{column.name}")
            said[same] = unused(found, said.values())
        ids[column] = said[same]
    return ids


def notebook(table: Table) -> str:
    """The table with bars of its intervals, as HTML that needs nothing around it."""
    return environment().get_template("notebook.html").render(tables=table.parts())
