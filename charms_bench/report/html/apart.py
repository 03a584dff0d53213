"""How far the egos of a run are apart: where each stands, and which pairs can be told apart."""

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from charms_bench.report.figures import INK, panels
from charms_bench.report.html.svg import COLOURS, MARKERS

PLACED = {"speed_mean": "mean speed, m/s", "dhw_mean": "mean headway to the leader, m"}
"""What egos are placed by, across and up: metrics, and the axes' words."""


def draw_places(long: pl.DataFrame) -> Figure:
    """Every ego by its mean speed and headway, with 95 % intervals."""
    first = long.unique(["agent", "metric"], keep="first", maintain_order=True)
    figure, (axes,) = panels(1, 5.4, 4.2)
    for k, name in enumerate(first["agent"].unique(maintain_order=True)):
        x, y = (first.filter(agent=name, metric=metric).row(0, named=True) for metric in PLACED)
        if x["value"] is None or y["value"] is None:
            continue
        axes.errorbar(
            x["value"],
            y["value"],
            xerr=_reach(x),
            yerr=_reach(y),
            fmt=MARKERS[k % len(MARKERS)],
            color=COLOURS[k % len(COLOURS)],
            elinewidth=1.0,
            markersize=6.5,
            label=name,
        )
    axes.set(**dict(zip(("xlabel", "ylabel"), PLACED.values(), strict=True)))
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def _reach(row: dict[str, float]) -> list[list[float]] | None:
    if row["low"] is None:
        return None
    return [[row["value"] - row["low"]], [row["high"] - row["value"]]]


def draw_separations(pairs: pl.DataFrame) -> Figure:
    """In how many metrics each pair of egos differs by more than chance."""
    names = list(dict.fromkeys([*pairs["first"], *pairs["second"]]))
    counted = np.full((len(names), len(names)), np.nan)
    found = pairs.group_by("first", "second", maintain_order=True).agg(pl.col("separated").sum())
    for first, second, count in found.iter_rows():
        counted[names.index(second), names.index(first)] = count
    metrics = pairs["metric"].n_unique()
    figure, (axes,) = panels(1, 5.4, 4.2)
    edges = np.arange(len(names) + 1) - 0.5
    axes.pcolormesh(
        edges, edges, np.ma.masked_invalid(counted), cmap="Blues", vmin=0, vmax=1.6 * metrics
    )
    for (i, j), count in np.ndenumerate(counted):
        if not np.isnan(count):
            axes.text(j, i, f"{count:.0f}", ha="center", va="center", color=INK, fontsize=9)
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right", fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set(xlim=(-0.5, len(names) - 1.5), ylim=(len(names) - 0.5, 0.5))
    axes.spines[:].set_visible(False)
    return figure
