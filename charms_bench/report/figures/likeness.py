"""The likeness of drivers to recorded drivers, as a figure."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from charms_bench.humans.likeness import COMPONENTS
from charms_bench.report.figures.drawing import EDGE, MARKERS, SERIES, panels
from charms_bench.runs.likeness import Likeness

_LOWEST = -6.0


def draw(rows: Sequence[Likeness]) -> Figure:
    """Draws the components and the total of each row; values below -6 lie on the left edge."""
    figure, (axes,) = panels(1, 7.5, 1.2 + 0.4 * len(rows))
    names = (*COMPONENTS, "total")
    for k, name in enumerate(names):
        label: str | None = name.replace("_", " ")
        for place, row in enumerate(rows):
            if name not in row.scores:
                continue
            score = row.scores[name]
            value, low, high = (max(each, _LOWEST) for each in (score.value, score.low, score.high))
            y = place + 0.18 * (k - 1.5)
            axes.plot([low, high], [y, y], color=SERIES[k], linewidth=1)
            style = {"marker": MARKERS[k], "color": SERIES[k], "linestyle": "", "label": label}
            axes.plot([value], [y], **style)
            label = None
    for value in (0.0, 1.0):
        axes.axvline(value, color=EDGE, linewidth=0.8)
    axes.set_yticks(range(len(rows)), [f"{row.label} ({row.kind})" for row in rows])
    axes.set(xlim=(_LOWEST - 0.1, 2.0), xlabel="likeness: 0 is the floor, 1 the ceiling")
    axes.invert_yaxis()
    axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
