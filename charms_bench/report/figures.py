"""What all figures share: a plain look, and a file written whole."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from charms_bench.errors import InputError
from charms_bench.world.files import write_atomically

ENDINGS = (".pdf", ".png", ".svg")
BLUE, GREY = "#2b6ca3", "#b9c2cb"
INK = "#1a1a1a"
"""On light fields of colour, whatever is behind the figure."""


def check_figure(path: Path) -> None:
    """Refuses a figure that could not be drawn.

    Raises:
        InputError: The file's ending is not a format's.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: expected a name that ends in {', '.join(ENDINGS)}")


def panels(
    count: int, width: float, height: float, stacked: bool = False
) -> tuple[Figure, Sequence[Any]]:
    """A figure of axes side by side, or one above the other, each of this size in inches."""
    rows, columns = (count, 1) if stacked else (1, count)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    every = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in every:
        axes.spines[["top", "right"]].set_visible(False)
    return figure, every


def take_text_as_it_is(figure: Figure) -> None:
    """Has names with dollar signs in them drawn, not read as formulas."""
    for text in figure.findobj(Text):
        text.set_parse_math(False)


def save(figure: Figure, path: Path) -> None:
    """Writes a figure in the format of the file's ending.

    Raises:
        InputError: The ending is not a format's, or the file cannot be written.
    """
    check_figure(path)
    take_text_as_it_is(figure)
    ending = path.suffix.lower().removeprefix(".")
    write_atomically(path, lambda partial: figure.savefig(partial, format=ending, dpi=150))
