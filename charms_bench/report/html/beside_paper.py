"""Ours beside the paper's: a panel a metric, our value with its interval and the paper's mark."""

from collections.abc import Sequence

import polars as pl
from matplotlib.figure import Figure

from charms_bench.report.figures import panels
from charms_bench.report.html.svg import COLOURS

PANELS = 4
"""Side by side at most."""


def draw_beside_paper(long: pl.DataFrame) -> list[Figure]:
    """Rows of panels, of the metrics that the paper reports; none where it reports none."""
    reported = long.filter(pl.col("paper").is_not_null())
    rows = long.filter(pl.col("metric_set").is_in(reported["metric_set"].unique().to_list()))
    named = rows["metric"].unique(maintain_order=True)
    metrics = named.filter(named.is_in(reported["metric"].unique().to_list())).to_list()
    return [_row(rows, metrics[start : start + PANELS]) for start in range(0, len(metrics), PANELS)]


def _row(rows: pl.DataFrame, metrics: Sequence[str]) -> Figure:
    rows = rows.with_columns(name=_names(rows))
    names = rows["name"].unique(maintain_order=True).to_list()
    figure, axes = panels(PANELS, 2.4, 0.9 + 0.27 * len(names))
    for panel in axes[len(metrics) :]:
        panel.remove()
    for k, (panel, metric) in enumerate(zip(axes, metrics, strict=False)):
        for row in rows.filter(metric=metric).iter_rows(named=True):
            place = names.index(row["name"])
            if row["low"] is not None:
                panel.plot([row["low"], row["high"]], [place, place], color=COLOURS[0], lw=3.5)
            if row["value"] is not None:
                panel.plot(row["value"], place, "o", color=COLOURS[0], markersize=5)
            if row["paper"] is not None:
                panel.plot(
                    row["paper"], place, "D", markersize=6.5, markerfacecolor="none",
                    markeredgecolor=COLOURS[1], markeredgewidth=1.5,
                )  # fmt: skip
        panel.set_yticks(range(len(names)), names if k == 0 else [""] * len(names), fontsize=8)
        panel.set_ylim(len(names) - 0.5, -0.5)
        panel.tick_params(axis="x", labelsize=7.5)
        panel.tick_params(axis="y", length=0)
        panel.grid(axis="y", linewidth=0.4, alpha=0.4)
        panel.spines["left"].set_visible(False)
        panel.margins(x=0.12)
        panel.locator_params(axis="x", nbins=4)
        panel.set_title(metric, fontsize=9)
    return figure


def _names(rows: pl.DataFrame) -> pl.Expr:
    """What a cell is called: by its ego, its traffic, or both where both differ."""
    if rows["traffic"].n_unique() == 1:
        return pl.col("agent")
    if rows["agent"].n_unique() == 1:
        return pl.col("traffic")
    return pl.format("{} in {}", "agent", "traffic")
