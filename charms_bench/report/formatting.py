"""How the numbers of a table are written: the same digits in every view."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from charms_bench.report.number import Cell, Number

if TYPE_CHECKING:
    from charms_bench.report.table import Column, Table

NOTHING = "–"
"""Stands for a value that is not defined."""


@dataclass(frozen=True)
class Written:
    """A cell as text; what is not defined is empty, and a value that is not defined `NOTHING`."""

    value: str
    low: str = ""
    high: str = ""
    reference: str = ""
    difference: str = ""
    """Value less reference."""
    n: str = ""
    marked: bool = False

    def interval(self, between: str) -> str:
        """The ends of the interval with a text between them; empty without an interval."""
        return f"{self.low}{between}{self.high}" if self.low and self.high else ""


def write_cells(table: Table) -> list[list[Written]]:
    """The cells of a table as text, row by row."""
    columns = [
        write_column(column, [row.cells[i] for row in table.rows])
        for i, column in enumerate(table.columns)
    ]
    return [list(cells) for cells in zip(*columns, strict=True)]


def write_column(column: Column, cells: Sequence[Cell]) -> list[Written]:
    """The cells of a column as text."""
    numbers = [cell for cell in cells if isinstance(cell, Number)]
    form = _percentage(numbers) if column.form == "%" else column.form or _four_digits(numbers)
    if column.signed:
        form = f"+{form}"
    return [Written(cell) if isinstance(cell, str) else _written(cell, form) for cell in cells]


def _written(number: Number, form: str) -> Written:
    if form.endswith("margin%"):
        form = form.replace("margin%", _two_digits_of_margin(number, 100.0) + "%")
    if form.endswith("margin"):
        form = form.replace("margin", _two_digits_of_margin(number) + "f")
    if form == "p":
        small = number.value is not None and number.value < 0.001
        return Written("<0.001" if small else _text(number.value, ".3f") or NOTHING)
    difference = None
    if number.value is not None and number.reference is not None:
        difference = number.value - number.reference
    return Written(
        value=_text(number.value, form) or NOTHING,
        low=_text(number.low, form).removesuffix(" %"),
        high=_text(number.high, form).removesuffix(" %"),
        # As it was reported, unless it becomes a percentage.
        reference=_text(number.reference, form if form.endswith("%") else "g"),
        difference=_text(difference, f"+{form.removeprefix('+')}"),
        n="" if number.n is None else f"{number.n:,}",
        marked=number.marked,
    )


def _text(number: float | None, form: str) -> str:
    if number is None or math.isnan(number):
        return ""
    if form.endswith("g"):  # without an exponent
        return f"{float(f'{number:{form}}'):z,.10g}"
    form = re.sub("^[+]?", r"\g<0>z", form)  # no minus zero
    return f"{number:{form}}".replace("%", " %").replace("inf", "∞")


def _decimals(value: float, digits: int) -> int:
    """The number of decimals that gives a number above 0 this many digits."""
    return digits - 1 - math.floor(math.log10(value))


def _four_digits(numbers: Iterable[Number]) -> str:
    """The form for a column: four digits of its largest number, three of one below 1."""
    largest = _largest(numbers) or 1.0
    decimals = min(5, _decimals(largest, 3)) if largest < 1 else max(0, _decimals(largest, 4))
    return f"{',' * (largest >= 1_000)}.{decimals}f"


def _percentage(numbers: Iterable[Number]) -> str:
    """The form for proportions: three digits of the largest percentage, 1 to 3 decimals."""
    largest = 100 * _largest(numbers)
    return f".{min(3, max(1, _decimals(largest, 3)))}%" if largest else ".1%"


def _largest(numbers: Iterable[Number]) -> float:
    found = [each for number in numbers for each in (number.value, number.high, number.reference)]
    return max(
        (abs(each) for each in found if each is not None and math.isfinite(each)), default=0.0
    )


def _two_digits_of_margin(number: Number, factor: float = 1.0) -> str:
    """The form for a number: two digits of the half-width of its interval, which limits it.

    It is without the letter of its type, and for the number times a factor. A number without an
    interval has three digits.
    """
    value, high = number.value or 0.0, number.high
    if number.value is not None and high is not None and 0 < high - value < math.inf:
        return f".{max(0, _decimals((high - value) * factor, 2))}"
    known = abs(value * factor)
    return f".{min(5, max(0, _decimals(known, 3)))}" if 0 < known < math.inf else ".0"
