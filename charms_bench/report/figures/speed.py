"""The speed of the engine over the number of scenes that advance together."""

from collections.abc import Sequence
from itertools import groupby
from typing import Protocol

from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import panels, series


class Measured(Protocol):
    """A measurement of `charms_bench.testing.bench.scale`."""

    @property
    def threads(self) -> int: ...
    @property
    def vehicles(self) -> int: ...
    @property
    def scenes(self) -> int: ...
    @property
    def vehicle_updates_per_s(self) -> float: ...


def draw_scale(measurements: Sequence[Measured]) -> Figure:
    """Vehicle updates per second over scenes, a line per number of threads and of vehicles."""
    figure, (axes,) = panels(1, 6.0, 4.0)

    def line(measurement: Measured) -> tuple[int, int]:
        return measurement.threads, measurement.vehicles

    for place, ((threads, vehicles), group) in enumerate(groupby(measurements, line)):
        points = [(m.scenes, m.vehicle_updates_per_s / 1e6) for m in group]
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
