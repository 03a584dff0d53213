"""Collisions over two parameters of each scenario, and the region in which they are preventable."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from charms_bench.report.figures.drawing import panels
from charms_bench.report.preventable_table import crashed
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite
from charms_bench.world.points import values_at

BINS = 14
REGION = "#8cc9a1"
FROM_WHITE = LinearSegmentedColormap.from_list("region", ["white", REGION])
PREVENTABLE: dict[str, Any] = {"color": "#c2122d", "marker": "o"}
UNAVOIDABLE: dict[str, Any] = {"color": "#7a8290", "marker": "x"}


def draw_preventable(suite: Suite, cells: Sequence[CellRows]) -> Figure | None:
    """Egos down, scenarios across, each over the first two parameters of its scenario.

    Green fields: the share of episodes that the reference driver survives. None without scenarios
    of two parameters.
    """
    numbers = np.arange(suite.seed, suite.seed + suite.episodes)
    points = {}
    for entry in suite.traffics:
        scenario = entry.traffic.scenario
        if scenario is not None and len(scenario.parameters) >= 2:
            points[entry.title] = list(values_at(scenario, numbers).items())[:2]
    if not points or suite.preventable_by is None:
        return None
    has_crashed = {(cell.agent, cell.traffic): crashed(cell) for cell in cells}
    egos = [ego.title for ego in suite.egos]
    count = len(egos) * len(points)
    figure, every = panels(count, 3.1, 2.15, len(points))
    for axes, (ego, title) in zip(every, product(egos, points), strict=True):
        (across, x), (up, y) = points[title]
        unavoidable = has_crashed[suite.preventable_by, title]
        edges = [
            np.linspace(each.min(), max(each.max(), each.min() + 1e-6), BINS) for each in (x, y)
        ]
        total, *_ = np.histogram2d(x, y, edges)
        survived, *_ = np.histogram2d(x[~unavoidable], y[~unavoidable], edges)
        with np.errstate(invalid="ignore"):
            share = np.ma.masked_invalid(survived / total)
        axes.pcolormesh(*edges, share.T, cmap=FROM_WHITE, vmin=0, vmax=1)
        mine = has_crashed[ego, title]
        for look, chosen in ((UNAVOIDABLE, mine & unavoidable), (PREVENTABLE, mine & ~unavoidable)):
            axes.plot(x[chosen], y[chosen], linestyle="", markersize=2.5, **look)
        axes.set_title(f"{ego}: {title}", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.set_xlabel(across, fontsize=8)
        axes.set_ylabel(up, fontsize=8)
    dots = [
        Line2D([], [], linestyle="", label=label, **look)
        for label, look in (("preventable", PREVENTABLE), ("not preventable", UNAVOIDABLE))
    ]
    field = Patch(color=REGION, label=f"{suite.preventable_by} survives")
    figure.legend(handles=[field, *dots], loc="outside upper center", ncols=3, frameon=False,
                  fontsize=8)  # fmt: skip
    return figure
