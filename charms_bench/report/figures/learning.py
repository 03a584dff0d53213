"""The learning curves of a training, a line per stage."""

import polars as pl
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from charms_bench.report.figures.drawing import panels, series
from charms_bench.report.training_tables import CurveColumn, Training


def draw_curves(training: Training) -> list[tuple[str, Figure]]:
    """The curves of a training with their titles: a figure per quantity, a line per stage.

    Stages whose curves are less than a quarter as long as others have a figure of their own.
    """
    drawn = []
    assert training.curves is not None
    stages = training.curves["stage"].unique(maintain_order=True).to_list()
    for name, curve, points in training.drawn():
        longest = pl.col(curve.over).max()
        is_long = longest.over("stage") * 4 > longest
        for part in points.with_columns(long=is_long).partition_by("long", maintain_order=True):
            title = curve.title[:1].upper() + curve.title[1:]
            title += f": {part['stage'][0]}" if part["stage"].n_unique() == 1 else ""
            drawn.append((title, _draw(part, name, curve, stages)))
    return drawn


def _draw(points: pl.DataFrame, name: str, curve: CurveColumn, stages: list[str]) -> Figure:
    figure, (axes,) = panels(1, 5.4, 3.9)
    for stage in points["stage"].unique(maintain_order=True):
        part = points.filter(stage=stage)
        style = series(stages.index(stage))
        axes.plot(part[curve.over], part[name], label=stage, linewidth=1.4, **style)
    axes.set(xlabel=curve.over, ylabel=curve.title)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if points[curve.over].max() > 10_000:  # type: ignore[operator]  # numeric, as `drawn` chose it
        axes.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:,.0f}k" if x else "0")
    if curve.form.endswith("%"):
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_formatter(lambda proportion, _: f"{100 * proportion:g} %")
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=7.5)
    return figure
