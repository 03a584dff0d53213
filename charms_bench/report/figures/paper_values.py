"""Values beside the paper's: a panel per metric, with our intervals and the paper's marks."""

from collections.abc import Sequence
from textwrap import fill

from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import SERIES, panels
from charms_bench.report.table import Table

PANELS = 4
"""Side by side at most."""
TITLE_WIDTH = 30
"""Letters in a line of a panel's title; longer lines run into the next panel."""


def draw_beside_paper(table: Table) -> list[Figure]:
    """Rows of panels for the metrics that the paper reports; none if it reports none."""
    places = table.reported()
    short = table.without_constant_keys()
    return [_row(short, places[k : k + PANELS]) for k in range(0, len(places), PANELS)]


def _row(table: Table, places: Sequence[int]) -> Figure:
    names = [" in ".join(row.labels) for row in table.rows]
    figure, axes = panels(PANELS, 2.4, 1.1 + 0.27 * len(names))
    for panel in axes[len(places) :]:
        panel.remove()
    for k, (panel, place) in enumerate(zip(axes, places, strict=False)):
        for at, number in enumerate(table.column(place)):
            if number.low is not None and number.high is not None:
                panel.plot([number.low, number.high], [at, at], color=SERIES[0], lw=3.5)
            if number.value is not None:
                panel.plot(number.value, at, "o", color=SERIES[0], markersize=5)
            if number.reference is not None:
                panel.plot(number.reference, at, "D", ms=6.5, mfc="none", mec=SERIES[1], mew=1.5)
        panel.set_yticks(range(len(names)), names if k == 0 else [""] * len(names), fontsize=8)
        panel.set_ylim(len(names) - 0.5, -0.5)
        panel.tick_params(axis="x", labelsize=7.5)
        panel.tick_params(axis="y", length=0)
        panel.grid(axis="y", linewidth=0.4, alpha=0.4)
        panel.spines["left"].set_visible(False)
        panel.margins(x=0.12)
        panel.locator_params(axis="x", nbins=4)
        if table.columns[place].form == "%":
            panel.xaxis.set_major_formatter(lambda proportion, _: f"{100 * proportion:g} %")
            panel.set_xlim(*_proportions(table))
        panel.set_title(fill(table.columns[place].title, TITLE_WIDTH), fontsize=9)
    return figure


def _proportions(table: Table) -> tuple[float, float]:
    """The ends of the axes of all proportions that the paper reports, so that they compare."""
    numbers = [
        number
        for place in table.reported()
        if table.columns[place].form == "%"
        for number in table.column(place)
    ]
    ends = [each for n in numbers for each in (n.value, n.high, n.reference) if each is not None]
    most = max(ends)
    return -0.06 * most, 1.12 * most
