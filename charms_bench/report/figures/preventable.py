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
from charms_bench.report.preventable_table import ONLY, crashed, kinds_of
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite
from charms_bench.world.parameter_points import values_at

BINS = 14
REGION = "#8cc9a1"
FROM_WHITE = LinearSegmentedColormap.from_list("region", ["white", REGION])
LOOKS: dict[str, dict[str, Any]] = {
    "not_preventable": {"color": "#7a8290", "marker": "x"},
    "preventable": {"color": "#c2122d", "marker": "o"},
}
OF_ONLY: tuple[dict[str, Any], ...] = (
    {"color": "#b35c00", "marker": "^"},
    {"color": "#5b3fa0", "marker": "v"},
)
"""Of collisions that only the first or only the second reference driver avoids."""
UNITS = {"mps2": "m/s²", "mps": "m/s", "m": "m", "s": "s"}
NO_EPISODE = "#e3e5e8"


def survivors(suite: Suite) -> str:
    """What the green fields of a suite's figure show."""
    if len(suite.preventable_by) == 1:
        return f"{suite.preventable_by[0]} survives"
    return f"{' and '.join(suite.preventable_by)} survive (lighter: one)"


def draw_preventable(suite: Suite, cells: Sequence[CellRows]) -> Figure | None:
    """Egos down, scenarios across, each over the first two parameters of its scenario.

    Green fields: the proportion of episodes that the reference driver survives, or the mean of
    the proportions of two. None without scenarios of two parameters.
    """
    points = {}
    episodes = {cell.traffic: cell.episodes["episode"] for cell in cells}
    for entry in suite.traffics:
        scenario = entry.traffic.scenario
        if scenario is not None and len(scenario.parameters) >= 2:
            numbers = episodes[entry.title].sort().to_numpy().astype(np.int64)
            points[entry.title] = list(values_at(scenario, numbers).items())[:2]
    if not points or not suite.preventable_by:
        return None
    has_crashed = {(cell.agent, cell.traffic): crashed(cell) for cell in cells}
    if not (kinds := kinds_of(suite, cells)):
        return None
    looks = LOOKS | dict(zip((ONLY + name for name in suite.preventable_by), OF_ONLY, strict=False))
    egos = [ego.title for ego in suite.egos]
    count = len(egos) * len(points)
    figure, every = panels(count, 3.1, 2.15, len(points))
    for axes, (ego, title) in zip(every, product(egos, points), strict=True):
        if (ego, title) not in kinds:
            axes.set_axis_off()  # it is not finished
            continue
        (across, x), (up, y) = points[title]
        crashes = [has_crashed[name, title] for name in suite.preventable_by]
        edges = [np.linspace(v.min(), max(v.max(), v.min() + 1e-6), BINS) for v in (x, y)]
        total, *_ = np.histogram2d(x, y, edges)
        survived, *_ = np.histogram2d(x, y, edges, weights=1.0 - np.mean(crashes, axis=0))
        with np.errstate(invalid="ignore"):
            proportion = np.ma.masked_invalid(survived / total)
        axes.pcolormesh(*edges, proportion.T, cmap=FROM_WHITE, vmin=0, vmax=1)
        of_ego = kinds[ego, title]
        for name in sorted(of_ego, key=list(looks).index):
            chosen = of_ego[name]
            dots = {"linestyle": "", "markersize": 2.5, "clip_on": False, **looks[name]}
            (line,) = axes.plot(x[chosen], y[chosen], **dots)
            line.set_in_layout(False)  # else points on the edge take the room of the titles
        axes.set_title(f"{ego}: {title}", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.set_facecolor(NO_EPISODE)
        axes.set_xlabel(in_words(across), fontsize=8)
        axes.set_ylabel(in_words(up), fontsize=8)
    markers = [
        Line2D([], [], linestyle="", label=name.replace("_", " "), **looks[name])
        for name in next(iter(kinds.values()))
    ]
    fields = [
        Patch(color=REGION, label=survivors(suite)),
        Patch(facecolor="white", edgecolor=REGION, label="white: no reference driver survives"),
        Patch(color=NO_EPISODE, label="no episode"),
    ]
    figure.legend(handles=[*fields, *markers], loc="outside upper center", ncols=2, frameon=False,
                  fontsize=8)  # fmt: skip
    return figure


def in_words(parameter: str) -> str:
    """A parameter's name as the title of an axis, such as `gap, m` for `gap_m`."""
    name, _, unit = parameter.rpartition("_")
    if not name or unit not in UNITS:
        name, unit = parameter, ""
    return name.replace("_", " ") + (f", {UNITS[unit]}" if unit else "")
