"""The composition of a traffic model, as a figure."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import SERIES, panels


def draw(found: Mapping[str, float], title: str) -> Figure:
    """Draws the proportions of the agents as bars."""
    figure, (axes,) = panels(1, 6.4, 0.9 + 0.32 * len(found))
    bars = axes.barh(list(found), list(found.values()), color=SERIES[0])
    axes.bar_label(bars, [f"{proportion:z.1%}" for proportion in found.values()], padding=3)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.xaxis.set_major_formatter(lambda proportion, _: f"{100 * proportion:g}%")
    axes.set(title=title, xlabel="proportion of vehicles")
    return figure
