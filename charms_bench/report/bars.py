"""Numbers drawn with characters: an interval on a scale, a curve as a line of blocks."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.text import Text

from charms_bench.report.number import Number

BLOCKS = "▁▂▃▄▅▆▇█"
INTERVAL, VALUE, REFERENCE, ZERO = "━", "●", "◇", "┊"


@dataclass(frozen=True)
class Scale:
    """What the first and the last of a row of characters stand for."""

    low: float
    high: float
    width: int

    @classmethod
    def over(cls, numbers: Iterable[float | None], width: int, zero: bool = False) -> "Scale":
        """A scale that holds all finite numbers, and 0 if asked to or if 0 is not far from them."""
        known = [number for number in numbers if number is not None and math.isfinite(number)]
        low, high = min(known, default=0.0), max(known, default=0.0)
        if zero or 0 <= low < high / 2:
            low, high = min(low, 0.0), max(high, 0.0)
        if low == high:
            high = low + (abs(low) or 1.0)
        return cls(low, high, width)

    def place(self, number: float) -> int:
        """The character, from 0, at which a number is drawn; infinity is drawn at the end."""
        within = min(max(number, self.low), self.high)
        return round((within - self.low) / (self.high - self.low) * (self.width - 1))


def bar(scale: Scale, number: Number) -> Text:
    """A value in its interval, with the reference value; what is not defined is not drawn."""
    row = [(" ", "")] * scale.width
    if scale.low < 0 < scale.high:
        row[scale.place(0.0)] = (ZERO, "dim")
    if number.low is not None and number.high is not None:
        for place in range(scale.place(number.low), scale.place(number.high) + 1):
            row[place] = (INTERVAL, "cyan")
    if number.value is not None:
        row[scale.place(number.value)] = (VALUE, "bold cyan")
    if number.reference is not None and row[scale.place(number.reference)][0] != VALUE:
        row[scale.place(number.reference)] = (REFERENCE, "magenta")
    return Text.assemble(*row)


def line(scale: Scale, values: Sequence[float]) -> str:
    """A curve from left to right, blocks as high as the scale says, at most `width` of them."""
    parts = np.array_split(np.asarray(values), min(scale.width, len(values)))
    steps = len(BLOCKS) - 1
    heights = [(part.mean() - scale.low) / (scale.high - scale.low) for part in parts]
    return "".join(BLOCKS[round(float(height) * steps)] for height in heights)
