"""Tables as Markdown: alone for a page, or as a document that says what its numbers are."""

import re
from collections.abc import Sequence
from dataclasses import replace

from charms_bench.metrics.labels import key_label_of, set_label_of
from charms_bench.report.formatting import NOTHING, Written, write_cells
from charms_bench.report.table import Column, Table


def markdown(table: Table, full: bool = False) -> str:
    """The table with intervals in brackets, marked numbers in bold, references in parentheses.

    If it is `full`, reference values have columns of their own, with the difference from them, and
    a row ends with n if all its numbers share it.
    """
    texts = write_cells(table)
    reported = [any(row[i].reference for row in texts) for i in range(len(table.columns))]
    header, reference = [key_label_of(key) for key in table.keys], _as_text(table.reference)
    for column, has_reference in zip(table.columns, reported, strict=True):
        beside = f" ({reference})" * (has_reference and not full)
        header.append(_as_text(column.title) + beside)
        header += [f"{reference} (difference)"] * (has_reference and full)
    counted = [{cell.n for cell in cells} for cells in texts]
    has_n = full and all(len(each) == 1 for each in counted) and {""} != set().union(*counted)
    header += ["n"] * has_n
    lines = []
    for row, cells in zip(table.rows, texts, strict=True):
        lines.append(list(map(_as_text, row.labels)))
        for known, cell, has_reference in zip(row.cells, cells, reported, strict=True):
            if isinstance(known, str):
                cell = replace(cell, value=_as_text(cell.value))
            lines[-1].append(_cell(cell, in_line=not full))
            if has_reference and full:
                difference = f" ({cell.difference})" * bool(cell.difference)
                lines[-1].append((cell.reference or NOTHING) + difference)
        lines[-1] += [cells[0].n] * has_n
    rule = "|" + "---|" * len(table.keys) + "---:|" * (len(header) - len(table.keys))
    head, *body = (f"| {' | '.join(line)} |" for line in (header, *lines))
    return "\n".join([head, rule, *body]) + "\n"


def document(table: Table, introduction: Sequence[str] = ()) -> str:
    """A document: paragraphs, then a table for each part, and what its columns are."""
    paragraphs = [
        *map(without_html, introduction),
        f"Values with 95 % intervals; {NOTHING} where none is defined.",
    ]
    paragraphs += [without_html(table.note)] if table.note else []
    legends: set[str] = set()
    for part in table.parts():
        legend = [
            f"- {_named(column)}: {column.definition}."
            + f" n: {column.counted}." * bool(column.counted)
            for column in part.columns
        ]
        legend = [line for line in map(without_html, legend) if line not in legends]
        legends.update(legend)
        group = part.columns[0].group if part.columns else ""
        which = f" (`{group}`)" if set_label_of(group) != group else ""
        paragraphs += [f"## {without_html(part.title + which)}", markdown(part, full=True).rstrip()]
        paragraphs += ["\n".join(legend)] if legend else []
    return "\n\n".join(paragraphs) + "\n"


def _named(column: Column) -> str:
    """The heading of a column, its unit, and the name that commands and CSV files use."""
    name = f"`{column.name.replace('`', '')}`"
    if column.heading == column.name.replace("_", " "):
        return f"{name} ({column.unit})" if column.unit else name
    return f"{column.title} ({name})"


def _cell(cell: Written, in_line: bool) -> str:
    value = f"**{cell.value}**" if cell.marked else cell.value
    interval = f" [{interval}]" if (interval := cell.interval(", ")) else ""
    reference = f" ({cell.reference})" if in_line and cell.reference else ""
    return f"{value}{interval}{reference}"


def _as_text(text: str) -> str:
    """A text from outside, escaped so that it is not a tag, a link or the end of a cell."""
    return without_html(re.sub(r"(\\(?=[\\|\]<])|\||\](?=[(\[:]))", r"\\\1", text))


def without_html(text: str) -> str:
    """Markdown without tags, which a browser would run; a `<` before a number stays."""
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", text)
