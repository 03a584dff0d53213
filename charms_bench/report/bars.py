"""Numbers as characters: an interval on a scale, a curve as a line of blocks.

Readable in one colour, and in a file.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.text import Text

BLOCKS = "▁▂▃▄▅▆▇█"
INTERVAL, VALUE, PAPER, ZERO = "━", "●", "◇", "┊"


@dataclass(frozen=True)
class Scale:
    """What the first and the last of some characters stand for."""

    low: float
    high: float
    width: int

    @classmethod
    def over(cls, numbers: Iterable[float | None], width: int, zero: bool = False) -> "Scale":
        """A scale that holds all numbers, and 0 if asked to or if they are not far from it."""
        there = [number for number in numbers if number is not None]
        low, high = min(there, default=0.0), max(there, default=0.0)
        if zero or 0 <= low < high / 2:
            low, high = min(low, 0.0), max(high, 0.0)
        if low == high:
            high = low + (abs(low) or 1.0)
        return cls(low, high, width)

    def place(self, number: float) -> int:
        """The character, from 0, that a number is at."""
        return round((number - self.low) / (self.high - self.low) * (self.width - 1))


def bar(
    scale: Scale,
    value: float | None,
    low: float | None,
    high: float | None,
    paper: float | None = None,
) -> Text:
    """A value in its interval, with the paper's value beside it; what there is none of is not."""
    row = [(" ", "")] * scale.width
    if scale.low < 0 < scale.high:
        row[scale.place(0.0)] = (ZERO, "dim")
    if low is not None and high is not None:
        for place in range(scale.place(low), scale.place(high) + 1):
            row[place] = (INTERVAL, "cyan")
    if value is not None:
        row[scale.place(value)] = (VALUE, "bold cyan")
    if paper is not None and row[scale.place(paper)][0] != VALUE:
        row[scale.place(paper)] = (PAPER, "magenta")
    return Text.assemble(*row)


def line(scale: Scale, values: Sequence[float]) -> str:
    """A curve from left to right, blocks as high as the scale says, at most `width` of them."""
    parts = np.array_split(np.asarray(values), min(scale.width, len(values)))
    steps = len(BLOCKS) - 1
    heights = [(part.mean() - scale.low) / (scale.high - scale.low) for part in parts]
    return "".join(BLOCKS[round(float(height) * steps)] for height in heights)
