"""Trade-offs as figures: speed against crashes, and how dense a traffic is against its crashes."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from charms_bench.report.figures import panels, save, take_text_as_it_is

FINE_TICKS = (0.001, 0.002, 0.005)
"""More of them, where all shares are small."""
TICKS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
COLOURS = ("#2b6ca3", "#c1502e", "#4d8b31", "#8a5fa8", "#b5892b", "#3a9a96", "#7a7a7a")
MARKERS = "osD^vPX"
BACKGROUND = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.5}
"""Keeps names legible where they lie on points."""


class Tradeoff(NamedTuple):
    """What is drawn against what."""

    across: str
    """A metric; where both metric sets have it, that of `standard`."""
    across_label: str
    share: str
    """A metric that is a share, drawn upwards."""
    share_label: str
    names: str
    """Whose names the points' numbers stand for: `agent` or `traffic`."""


OF_EGOS = Tradeoff("speed_mean", "mean speed, m/s", "crashed_episodes", "episodes crashed", "agent")
OF_TRAFFICS = Tradeoff(
    "interaction_density",
    "vehicles within 30 m and a lane of the ego",
    "traffic_crashed",
    "vehicles of the traffic crashed in an episode",
    "traffic",
)


def write_tradeoff(path: Path, long: pl.DataFrame, tradeoff: Tradeoff = OF_EGOS) -> None:
    """Writes what `draw_tradeoff` draws.

    Raises:
        InputError: The file's ending is not a format's, or it cannot be written.
    """
    save(draw_tradeoff(long, tradeoff), path)


def draw_tradeoff(
    long: pl.DataFrame,
    tradeoff: Tradeoff = OF_EGOS,
    width: float = 8.6,
    height: float = 5.2,
) -> Figure:
    """The cells of a table with their 95 % intervals.

    Points carry their names, or numbers of a list where they are of several groups.

    Args:
        long: `tables.LONG_SCHEMA`.
        tradeoff: What is drawn.
        width: Of the figure, inches.
        height: Likewise.
    """
    cells = _cells(long, tradeoff)
    names = cells[tradeoff.names].unique(maintain_order=True).to_list()
    figure, (axes,) = panels(1, width, height)
    texts: list[Annotation] = []
    grouped = "traffic" if tradeoff.names == "agent" else "agent"
    groups = cells[grouped].unique(maintain_order=True).to_list()
    for index, group in enumerate(groups):
        part = cells.filter(pl.col(grouped) == group)
        colour = COLOURS[index % len(COLOURS)]
        x, y = part["x"].to_numpy(), part["y"].to_numpy()
        axes.errorbar(
            x,
            y,
            xerr=_reach(x, part["x_low"].to_numpy(), part["x_high"].to_numpy()),
            yerr=_reach(y, part["y_low"].to_numpy(), part["y_high"].to_numpy()),
            fmt=MARKERS[index % len(MARKERS)],
            color=colour,
            ecolor=colour,
            elinewidth=0.8,
            label=group,
        )
        for name, left, up in zip(part[tradeoff.names], x, y, strict=True):
            label = name if len(groups) == 1 else str(names.index(name) + 1)
            texts.append(axes.annotate(label, (left, up), fontsize=8, bbox=BACKGROUND))
    # Roots, so that the few crashes of good drivers are not all one point.
    axes.set_yscale("function", functions=(_root, np.square))
    top = axes.get_ylim()[1]
    axes.set_ylim(0, top)
    ticks = TICKS if top > 0.05 else (*TICKS, *FINE_TICKS)
    axes.set_yticks(sorted(share for share in ticks if share < top))
    axes.margins(x=0.12)
    axes.yaxis.set_major_formatter(lambda share, _: f"{100 * share:g} %")
    axes.set(xlabel=tradeoff.across_label, ylabel=f"{tradeoff.share_label}\n(square-root scale)")
    if len(groups) > 1:
        listed = "\n".join(f"{number}  {name}" for number, name in enumerate(names, 1))
        place = {"transform": axes.transAxes, "va": "top"}
        axes.text(1.02, 1.0, listed, fontsize=8, linespacing=1.5, **place)
        axes.legend(
            title=grouped,
            frameon=False,
            fontsize=8,
            title_fontsize=8,
            loc="lower left",
            bbox_to_anchor=(1.0, 0.0),
        )
    take_text_as_it_is(figure)
    figure.draw_without_rendering()  # only then is it known where points are
    _place(texts)
    return figure


def _place(texts: list[Annotation]) -> None:
    """Moves labels up until none lies on another."""
    taken: list[Bbox] = []
    for text in sorted(texts, key=lambda text: text.get_window_extent().y0):
        up = 4
        while True:
            text.set_position((5, up))
            text.set_anncoords("offset points")
            box = text.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                break
            up += 4
        taken.append(box)


def _root(shares: np.ndarray) -> np.ndarray:
    root: np.ndarray = np.sqrt(np.maximum(shares, 0.0))
    return root


def _cells(long: pl.DataFrame, tradeoff: Tradeoff) -> pl.DataFrame:
    """A row a cell with its two metrics."""
    keys = ["agent", "traffic"]
    last = long.unique([*keys, "metric"], keep="last", maintain_order=True)

    def of(metric: str, name: str) -> pl.DataFrame:
        numbers = {"value": name, "low": f"{name}_low", "high": f"{name}_high"}
        columns = [pl.col(column).alias(alias) for column, alias in numbers.items()]
        return last.filter(metric=metric).select(*keys, *columns)

    x, y = of(tradeoff.across, "x"), of(tradeoff.share, "y")
    return x.join(y, on=keys, maintain_order="left").drop_nulls(["x", "y"])


def _reach(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """How far intervals reach below and above values, (2, M); 0 where there is none."""
    reach: np.ndarray = np.nan_to_num(np.stack([values - low, high - values])).clip(min=0.0)
    return reach
