"""The shares of the agents in a traffic, as a figure."""

from collections.abc import Mapping
from pathlib import Path

from charms_bench.report.figures.drawing import SERIES, panels, save


def draw(found: Mapping[str, float], title: str, path: Path) -> None:
    """Draws shares as bars.

    Raises:
        InputError: The file's ending is not a format's, or it cannot be written.
    """
    figure, (axes,) = panels(1, 6.4, 0.9 + 0.32 * len(found))
    bars = axes.barh(list(found), list(found.values()), color=SERIES[0])
    axes.bar_label(bars, [f"{share:z.1%}" for share in found.values()], padding=3)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.xaxis.set_major_formatter(lambda share, _: f"{100 * share:g}%")
    axes.set(title=title, xlabel="proportion of vehicles")
    save(figure, path)
