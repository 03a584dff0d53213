"""What all figures share: colours, axes with a plain look, error bars, a file written whole."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.typing import ColorType

from charms_bench.foundation.files import MARK, check_ending, write_atomically
from charms_bench.report.number import Number
from charms_bench.world.scene import Floats

ENDINGS = (".pdf", ".png", ".svg")
SERIES = (
    "#0072b2", "#d55e00", "#009e73", "#b5679a", "#b07900", "#3a96d0", "#7a8290", "#96602c"
)  # fmt: skip
"""For lines and points, after Okabe & Ito 2008; each stands out from white and black by 3 to 1."""
MARKERS = "osD^vPX*"
LINE_STYLES = ("-", "--", ":", "-.")
GREY = "#b9c2cb"
EDGE = "#6b7785"
PAPER = "#fffffe"
"""What is behind the figure: white in a file, and in a page the colour of the page."""
LIGHT, DARK = "#ffffff", "#010101"
"""Text on fields of colour, whatever is behind the figure. One of the two stands out from any field
by 4.5 to 1. Black itself would take the colour of the page's text."""


def panels(
    count: int, width: float, height: float, side_by_side: int | None = None
) -> tuple[Figure, Sequence[Any]]:
    """A figure of `count` axes, each of this size in inches, all `side_by_side` by default."""
    columns = min(count, side_by_side or count)
    rows = -(-count // columns)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    every = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in every:
        axes.spines[["top", "right"]].set_visible(False)
    for axes in every[count:]:
        axes.remove()
    return figure, every[:count]


def series(place: int) -> dict[str, str]:
    """The colour and line style of a line, different for the first 32 places."""
    style = LINE_STYLES[(place + place // len(SERIES)) % len(LINE_STYLES)]
    return {"color": SERIES[place % len(SERIES)], "linestyle": style}


def points(place: int) -> dict[str, str]:
    """The colour and marker of a group of points."""
    return {"color": SERIES[place % len(SERIES)], "marker": MARKERS[place % len(MARKERS)]}


def crosses(axes: Any, x: Sequence[Number], y: Sequence[Number], **look: Any) -> None:
    """Draws points with their 95 % intervals; all have a value, not all an interval."""
    ends = [np.array([(n.value, n.low, n.high) for n in each], dtype=float) for each in (x, y)]
    xerr, yerr = (
        np.nan_to_num(np.maximum(0.0, [value - low, high - value]))
        for value, low, high in (each.T for each in ends)
    )
    axes.errorbar(ends[0][:, 0], ends[1][:, 0], xerr=xerr, yerr=yerr, linestyle="", **look)


def heat_map(
    axes: Any,
    values: Floats,
    texts: Sequence[Sequence[str]],
    rows: Sequence[str],
    columns: Sequence[str],
    **colours: Any,
) -> None:
    """Draws a matrix as coloured fields with a text in each, rows from the top; NaN stays empty.

    `colours` are options of `pcolormesh`.
    """
    edges = (np.arange(values.shape[1] + 1) - 0.5, np.arange(values.shape[0] + 1) - 0.5)
    mesh = axes.pcolormesh(*edges, np.ma.masked_invalid(values), **colours)
    for (i, j), value in np.ndenumerate(values):
        if not np.isnan(value):
            colour = max(LIGHT, DARK, key=partial(contrast, mesh.to_rgba(value)))
            axes.text(j, i, texts[i][j], ha="center", va="center", color=colour, fontsize=8)
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    axes.set_xticks(range(len(columns)), columns, rotation=35, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)


def contrast(one: ColorType, other: ColorType) -> float:
    """How far two colours stand apart, from 1 to 21: the contrast ratio of WCAG 2.2."""
    bright, dim = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (bright + 0.05) / (dim + 0.05)


def _luminance(colour: ColorType) -> float:
    """The relative luminance of WCAG 2.2."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@contextmanager
def any_letters() -> Iterator[None]:
    """Draws a box for a letter that the font does not have, without a warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        yield


def take_text_as_it_is(figure: Figure) -> None:
    """Draws names with dollar signs as they are, instead of reading them as formulas."""
    for text in figure.findobj(Text):
        text.set_parse_math(False)


def save(figure: Figure, path: Path) -> None:
    """Writes a figure in the format of the file's ending; an `InputError` if it cannot be."""
    check_ending(path, *ENDINGS)
    take_text_as_it_is(figure)
    ending = path.suffix.lower().removeprefix(".")
    with any_letters():
        options: dict[str, Any] = {"format": ending, "dpi": 150, "metadata": {"Creator": MARK}}
        write_atomically(path, lambda partial: figure.savefig(partial, **options))
