"""Speed against crashes: the trade-off that every driver makes, as a figure."""

from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from charms_bench.figures import panels, save

SPEED, CRASHES = "speed_mean", "crashed_episodes"
TICKS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
COLOURS = ("#2b6ca3", "#c1502e", "#4d8b31", "#8a5fa8", "#b5892b", "#3a9a96", "#7a7a7a")


def write_tradeoff(path: Path, long: pl.DataFrame) -> None:
    """Draws the cells of a table: mean speed across, share of crashed episodes up.

    Args:
        path: The figure's file.
        long: `tables.LONG_SCHEMA`, of which the metric set `standard` is drawn.

    Raises:
        InputError: The file's ending is not a format's, or it cannot be written.
    """
    cells = _cells(long)
    figure, (axes,) = panels(1, 8.0, 5.2)
    texts: list[Annotation] = []
    traffics = cells["traffic"].unique(maintain_order=True).to_list()
    for index, traffic in enumerate(traffics):
        part = cells.filter(traffic=traffic)
        colour = COLOURS[index % len(COLOURS)]
        x, y = part["speed"].to_numpy(), part["crashed"].to_numpy()
        axes.errorbar(
            x,
            y,
            xerr=_reach(x, part["speed_low"].to_numpy(), part["speed_high"].to_numpy()),
            yerr=_reach(y, part["crashed_low"].to_numpy(), part["crashed_high"].to_numpy()),
            fmt="o",
            color=colour,
            ecolor=colour,
            elinewidth=0.8,
            label=traffic,
        )
        for agent, speed, crashed in zip(part["agent"], x, y, strict=True):
            texts.append(axes.annotate(agent, (speed, crashed), fontsize=8, color=colour))
    # Roots, so that the few crashes of good drivers are not all one point.
    axes.set_yscale("function", functions=(_root, np.square))
    top = axes.get_ylim()[1]
    axes.set_ylim(0, top)
    axes.set_yticks([share for share in TICKS if share < top])
    axes.margins(x=0.12)
    axes.yaxis.set_major_formatter(lambda share, _: f"{100 * share:g} %")
    axes.set(
        title="Speed against crashes, with 95 % intervals",
        xlabel="mean speed, m/s",
        ylabel="episodes crashed",
    )
    if len(traffics) > 1:
        axes.legend(title="traffic", frameon=False, fontsize=8)
    figure.draw_without_rendering()  # only then is it known where points are
    _place(texts)
    save(figure, path)


def _place(texts: list[Annotation]) -> None:
    """Moves labels up until none lies on another."""
    taken: list[Bbox] = []
    for text in sorted(texts, key=lambda text: text.get_window_extent().y0):
        up = 4
        while True:
            text.set_position((6, up))
            text.set_anncoords("offset points")
            box = text.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                break
            up += 4
        taken.append(box)


def _root(shares: np.ndarray) -> np.ndarray:
    root: np.ndarray = np.sqrt(np.maximum(shares, 0.0))
    return root


def _cells(long: pl.DataFrame) -> pl.DataFrame:
    """A row a cell with its speed and its crashes."""
    standard = long.filter(pl.col("metric_set").str.starts_with("standard-"))
    keys = ["agent", "traffic"]

    def of(metric: str, name: str) -> pl.DataFrame:
        columns = [pl.col(c).alias(n) for c, n in _names(name).items()]
        return standard.filter(metric=metric).select(*keys, *columns)

    speeds, crashes = of(SPEED, "speed"), of(CRASHES, "crashed")
    return speeds.join(crashes, on=keys, maintain_order="left").drop_nulls(["speed", "crashed"])


def _names(name: str) -> dict[str, str]:
    return {"value": name, "low": f"{name}_low", "high": f"{name}_high"}


def _reach(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """How far intervals reach below and above values, (2, M); 0 where there is none."""
    reach: np.ndarray = np.nan_to_num(np.stack([values - low, high - values])).clip(min=0.0)
    return reach
