"""Tables in a terminal: as numbers side by side (`grid`), or drawn to scale (`drawn`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from io import StringIO
from itertools import chain
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, Group
from rich.table import Table as RichTable
from rich.text import Text

from charms_bench.metrics.labels import key_label_of
from charms_bench.report.bars import INTERVAL, REFERENCE, VALUE, Scale, bar
from charms_bench.report.formatting import Written, write_cells, write_column
from charms_bench.report.number import Number

if TYPE_CHECKING:
    from charms_bench.report.table import Column, Table

COLUMN_WIDTH = 16
"""Characters that a column of numbers needs: its interval and the space around it."""
NARROWEST, WIDEST = 8, 44
"""Characters of a bar."""
GAP = 2
LINES = 20
"""Lines of the rows in the beginning of a table."""
MOST = 8
"""Columns of a compact table."""


def compact(table: Table, width: int = 100) -> Group:
    """The first columns of a table that fit side by side into a width, at most `MOST` of them.

    Columns that do not fit are named below.
    """
    widths = fitting(table, width)
    shown = replace(table.take(range(len(widths))), title="")
    more = "; ".join(column.heading for column in table.columns[len(widths) :])
    found = _grid(shown, True, width, _room(table, width // 2, width - COLUMN_WIDTH), widths)
    below = map(Text, filter(None, (table.note, more and f"More columns: {more}.")))
    return Group(*[Text(table.title)] * bool(table.title), found, *below)


def fitting(table: Table, width: int) -> list[int]:
    """The characters of each of the first columns, as many as `compact` shows."""
    left, widths = width - _room(table, width // 2, width - COLUMN_WIDTH) - 4, []
    texts = write_cells(table)
    for i, column in enumerate(table.columns[:MOST]):
        cells = (_stacked(row[i], table.reference).plain for row in texts)
        lines = [*column.title.split(), *chain.from_iterable(map(str.splitlines, cells))]
        widths.append(max(map(len, lines)))
        left -= widths[-1] + 3
        if left < 0 and i:
            widths.pop()
            break
    return widths


def _room(table: Table, usual: int, most: int) -> int:
    """The characters for labels: those that they need, up to the usual ones.

    At `most` so many are given so that no word of a label breaks.
    """
    whole, words = _label_widths(table)
    return min(whole, max(usual, words if words <= most else 0))


def _label_widths(table: Table) -> tuple[int, int]:
    """The characters that labels need side by side on one line, and those of their words."""
    by_row = (map(key_label_of, table.keys), *(row.labels for row in table.rows))
    keys = [list(key) for key in zip(*by_row, strict=True)]
    apart = 3 * len(keys) - 3
    return sum(max(map(len, key)) for key in keys) + apart, sum(map(_longest_word, keys)) + apart


def grid(table: Table, width: int = 100, stacked: bool = True) -> Group:
    """The table with as many columns side by side as fit into a width in characters.

    If it is `stacked`, an interval and a reference value stand under the value; else the interval
    has a column of its own, and all columns stand in one block. Labels that take more than half of
    the width, or a third of it if the table is not stacked, are wrapped.
    """
    most = width - COLUMN_WIDTH - 6 if stacked else 0
    room = _room(table, width // 2 if stacked else width // 3, most)
    side_by_side = max(1, (width - room - 6) // COLUMN_WIDTH) if stacked else len(table.columns)
    found = [
        _grid(block, stacked, width, room)
        for part in table.parts()
        for block in part.blocks(side_by_side)
    ]
    return Group(*found, *([Text(table.note)] if table.note else []))


def beginning(table: Table, width: int = 100) -> str:
    """The first rows and columns of a table as text, and how many more there are."""
    shown = _first_rows(table.without_constant_keys())
    if len({column.group for column in table.columns}) > 1:
        shown = shown.named(*(f"{each.name} {each.group}".strip() for each in table.columns))
    shown = shown.take(range(len(fitting(shown, width))))
    first = dict(zip(table.keys, table.rows[0].labels, strict=True)) if table.rows else {}
    same = ", ".join(f"{key} {label}" for key, label in first.items() if key not in shown.keys)
    title = f"{table.title} ({same})" if same else table.title
    console = Console(width=width, file=StringIO(), color_system=None, emoji=False)
    with console.capture() as captured:
        console.print(Text(title), _grid(replace(shown, title=""), stacked=True))
    left = [
        f"{of - among} more {what}{'s' * (of - among > 1)}"
        for what, among, of in (
            ("row", len(shown.rows), len(table.rows)),
            ("column", len(shown.columns), len(table.columns)),
        )
        if of > among
    ]
    more = f"{' and '.join(left)}: .select(...) chooses columns, .frame() has all numbers"
    lines = [line.rstrip() for line in captured.get().splitlines()]
    return "\n".join([*filter(None, lines), *([more] if left else [])])


def _first_rows(table: Table) -> Table:
    """The table with as many of its rows as fit into `LINES`."""
    numbers = [number for row in table.rows for number in row.numbers]
    lines = 1 + any(each.low is not None for each in numbers)
    lines += any(each.reference is not None for each in numbers)
    return replace(table, rows=table.rows[: LINES // lines])


def _grid(
    table: Table,
    stacked: bool,
    width: float = math.inf,
    room: float = math.inf,
    widths: Sequence[int] | None = None,
) -> RichTable:
    """The columns of a table side by side; no word breaks if a `width` has room for all of them.

    Labels that need more than the `room` for them are wrapped.
    """
    title, texts = Text(table.title) if table.title else None, write_cells(table)
    made = RichTable(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    made.padding = (0, 1) if stacked else (0, 1, 0, 0)
    count, headings = len(table.columns), [column.title for column in table.columns]
    has_interval = [not stacked and any(row[i].low for row in texts) for i in range(count)]
    is_text = [any(isinstance(row.cells[i], str) for row in table.rows) for i in range(count)]
    labels = [key_label_of(key) for key in table.keys]
    words = [[label, *(row.labels[k] for row in table.rows)] for k, label in enumerate(labels)]
    words += [
        [heading, *(row[i].value for row in texts if is_text[i])]
        for i, heading in enumerate(headings)
    ]
    least = list(map(_longest_word, words))
    if sum(least) + 3 * len(least) + COLUMN_WIDTH * sum(has_interval) > width:
        least = [_longest_word([heading]) for heading in (*labels, *headings)]
    wraps = _label_widths(table)[0] > room
    for label, narrowest in zip(labels, least, strict=False):
        made.add_column(label, no_wrap=not wraps, overflow="fold", min_width=narrowest)
    for i, heading in enumerate(headings):
        made.add_column(
            heading,
            justify="left" if is_text[i] else "right",
            overflow="fold",
            width=None if widths is None else widths[i],
            min_width=least[len(labels) + i],
        )
        if has_interval[i]:
            made.add_column("95 % interval", justify="right")
    for row, cells in zip(table.rows, texts, strict=True):
        marked = not stacked and any(cell.marked for cell in cells)
        shown: list[Text] = []
        for cell, with_interval in zip(cells, has_interval, strict=True):
            shown.append(_stacked(cell, table.reference) if stacked else Text(_value(cell)))
            shown += [Text(cell.interval(", "))] * with_interval
        made.add_row(*map(Text, row.labels), *shown, style="bold" if marked else "")
    return made


def _longest_word(texts: Iterable[str]) -> int:
    """The characters that texts need so that no word of them breaks."""
    return max((len(word) for text in texts for word in text.split()), default=0)


def _value(cell: Written) -> str:
    return cell.value + "*" * cell.marked


def _stacked(cell: Written, reference: str) -> Text:
    text = Text(_value(cell), style="bold")
    if interval := cell.interval(_between(cell)):
        text.append(f"\n{interval}", style="not bold dim")
    if cell.reference:
        text.append(f"\n{reference} {cell.reference}", style="not bold")
    return text


def _between(cell: Written) -> str:
    """What separates the ends of an interval, which may have signs."""
    return ", " if cell.low.startswith(("-", "+")) else "–"


def drawn(table: Table, width: int = 100) -> Group:
    """The table, whose cells are numbers, drawn to scale column by column, `width` characters."""
    parts: list[Text | RichTable] = []
    table = table.without_constant_keys()
    for part in table.parts():
        parts += [Text(f"\n{part.title}", style="bold")] if part.title else []
        parts.append(_drawn(part, width))
    numbers = [number for row in table.rows for number in row.numbers]
    *outer, inner = map(key_label_of, table.keys)
    legend = [f"{inner} indented under {' '.join(outer)}"] if outer else []
    if any(number.low is not None for number in numbers):
        legend.append(f"{INTERVAL * 2}{VALUE}{INTERVAL * 2} value in its 95 % interval")
    if any(number.reference is not None for number in numbers):
        legend.append(f"{REFERENCE} {table.reference}")
    if table.note:
        marked = any(number.marked for number in numbers)
        legend.append("*: " * marked + table.note)
    return Group(*parts, Text("\n" + "; ".join(legend)) if legend else "")


_Line = tuple[tuple[str, str, str, str], Number | None]
"""A printed line: label, value, interval and reference; and the number to draw, if any."""


def _drawn(table: Table, width: int) -> RichTable:
    """A block of lines for each column: its scale, then a bar per row."""
    blocks = [_block(table, i) for i in range(len(table.columns))]
    taken = [max(len(texts[i]) for block in blocks for texts, _ in block) for i in range(4)]
    label_width = min(taken[0], max(NARROWEST, width - sum(taken[1:]) - 2 * NARROWEST - 4 * GAP))
    room = min(WIDEST, max(NARROWEST, width - label_width - sum(taken[1:]) - 4 * GAP))
    made = RichTable(box=None, padding=(0, GAP, 0, 0), pad_edge=False, show_header=False)
    made.add_column(width=label_width, overflow="fold")
    made.add_column(width=taken[1], justify="right", no_wrap=True)
    made.add_column(width=taken[2], justify="right", no_wrap=True)
    made.add_column(width=room, no_wrap=True)
    made.add_column(width=taken[3], justify="right", no_wrap=True)
    for index, (column, block) in enumerate(zip(table.columns, blocks, strict=True)):
        numbers = [number for _, number in block if number]
        ends = [e for n in numbers for e in (n.value, n.low, n.high, n.reference)]
        scale = Scale.over(ends, room, zero=column.signed or column.form.endswith("%"))
        if index:
            made.add_row()
        for line, (texts, number) in enumerate(block):
            label, value, interval, reference = map(Text, texts)
            picture = bar(scale, number) if number else Text() if line else _axis(scale, column)
            label.stylize("" if line else "bold")
            made.add_row(label, value, interval, picture, reference)
    return made


def _block(table: Table, place: int) -> list[_Line]:
    column, numbers = table.columns[place], table.column(place)
    reported = any(number.reference is not None for number in numbers)
    head = (column.heading, "", column.heading_unit, table.reference if reported else "")
    lines: list[_Line] = [(head, None)]
    above = None
    for row, number, cell in zip(table.rows, numbers, write_column(column, numbers), strict=True):
        *outer, label = row.labels
        if outer and outer != above:
            lines.append(((f"  {' '.join(outer)}", "", "", ""), None))
        above = outer
        text = "  " * (1 + bool(outer)) + label
        texts = (text, _value(cell), cell.interval(_between(cell)), cell.reference)
        lines.append((texts, number))
    return lines


def _axis(scale: Scale, column: Column) -> Text:
    """The ends of a scale, above its bars."""
    factor, sign = (100, " %") if column.form.endswith("%") else (1, "")
    low, high = (f"{factor * end:z,.4g}{sign}" for end in (scale.low, scale.high))
    return Text(low + high.rjust(scale.width - len(low)), style="dim")
