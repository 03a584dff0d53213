"""The speed of the engine over the number of scenes that advance together."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import panels, series


def draw_scale(records: Sequence[Mapping[str, Any]]) -> Figure:
    """Vehicle updates per second over scenes, a line per number of threads and of vehicles.

    The records are those of `charms_bench.testing.bench.scale`.
    """
    figure, (axes,) = panels(1, 6.0, 4.0)
    line = itemgetter("threads", "vehicles")
    for place, ((threads, vehicles), group) in enumerate(groupby(records, line)):
        points = [(each["scenes"], each["vehicle_updates_per_s"] / 1e6) for each in group]
        label = f"{vehicles:,} vehicles, {threads} thread{'s' * (threads > 1)}"
        axes.plot(*zip(*points, strict=True), label=label, marker=".", **series(place))
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="scenes per thread",
        ylabel="million vehicle updates per second",
    )
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=8)
    return figure
