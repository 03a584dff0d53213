"""The learning curves of a training: what rises over steps, and what over epochs."""

from collections.abc import Mapping

import polars as pl
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from charms_bench.report.figures import panels
from charms_bench.report.html.svg import COLOURS, STYLES

MEASURED: Mapping[str, Mapping[str, str]] = {
    "steps": {"return_mean": "return of an episode", "crashed_share": "episodes crashed"},
    "epoch": {"loss": "loss", "agreement": "agreement with held-out decisions"},
}
"""What is drawn over what, if it is there, and the axis' words."""
SHARES = ("crashed_share", "agreement")


def draw_curves(curves: pl.DataFrame) -> dict[str, Figure]:
    """The curves of a training by title: a figure a quantity, a line a stage.

    Stages of other lengths, such as one of forty epochs among some of four, have their own.

    Args:
        curves: A row a `stage` and point, with some columns of `MEASURED`.
    """
    drawn = {}
    stages = curves["stage"].unique(maintain_order=True).to_list()
    for across, quantities in MEASURED.items():
        for quantity, words in quantities.items():
            if not {across, quantity} <= set(curves.columns):
                continue
            points = curves.drop_nulls([across, quantity])
            for part in _by_length(points, across):
                names = part["stage"].unique(maintain_order=True).to_list()
                title = words[:1].upper() + words[1:] + (f": {names[0]}" if len(names) == 1 else "")
                drawn[title] = _draw(part, across, quantity, words, stages)
    return drawn


def _by_length(points: pl.DataFrame, across: str) -> list[pl.DataFrame]:
    if across == "steps":
        return [points] if len(points) else []
    longest = pl.col(across).max().over("stage").alias("longest")
    return points.with_columns(longest).partition_by("longest", maintain_order=True)


def _draw(
    points: pl.DataFrame, across: str, quantity: str, words: str, stages: list[str]
) -> Figure:
    figure, (axes,) = panels(1, 5.4, 3.9)
    for stage in points["stage"].unique(maintain_order=True):
        part, place = points.filter(stage=stage), stages.index(stage)
        axes.plot(
            part[across],
            part[quantity],
            label=stage,
            color=COLOURS[place % len(COLOURS)],
            linestyle=STYLES[(place + place // len(COLOURS)) % len(STYLES)],
            linewidth=1.4,
        )
    axes.set(xlabel=across, ylabel=words)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if across == "steps":
        axes.xaxis.set_major_formatter(lambda steps, _: f"{steps / 1000:,.0f}k" if steps else "0")
    if quantity in SHARES:
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_formatter(lambda share, _: f"{100 * share:g} %")
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=7.5)
    return figure
