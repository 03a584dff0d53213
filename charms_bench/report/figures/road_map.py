"""A road map seen from above: its lanes, where they conflict, and its signals."""

from itertools import groupby
from operator import attrgetter

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from charms_bench.foundation.arrays import Floats
from charms_bench.maps.road_map import MapLane, RoadMap
from charms_bench.maps.sampling import lengths_of
from charms_bench.report.figures.drawing import EDGE, GREY, SERIES, panels

_SIZE_IN = 9.0
_MOST_ARROWS = 2_000
_KINDS = {"crossing": (SERIES[1], "x"), "merging": (SERIES[2], "o")}


def draw(road: RoadMap) -> Figure:
    """A figure of the map, in its own coordinates: east to the right, north up."""
    lanes = list(road.lanes)
    low = np.min([lane.points[:, :2].min(axis=0) for lane in lanes], axis=0)
    high = np.max([lane.points[:, :2].max(axis=0) for lane in lanes], axis=0)
    aspect = float((high - low + 20)[1] / (high - low + 20)[0])
    size = (_SIZE_IN, _SIZE_IN * aspect) if aspect < 1 else (_SIZE_IN / aspect, _SIZE_IN)
    figure, (axes,) = panels(1, max(size[0], 4.0), max(size[1], 2.5) + 0.6)
    areas, lines = [_area(lane) for lane in lanes], [_in_map(road, lane.points) for lane in lanes]
    areas = [_in_map(road, each) for each in areas]
    axes.add_collection(PolyCollection(areas, facecolors=GREY, edgecolors="none", alpha=0.5))
    axes.add_collection(LineCollection(lines, colors=EDGE, linewidths=0.5))
    _draw_arrows(axes, lines)
    at = {lane.id: lane for lane in lanes}
    by_kind = attrgetter("kind")
    for kind, group in groupby(sorted(road.conflicts, key=by_kind), by_kind):
        several = [_point(at[each.lanes[0]].points, each.at[0]) for each in group]
        x, y = _in_map(road, np.array(several)).T
        colour, marker = _KINDS[kind]
        label = f"{kind} ({len(several):,})"
        axes.plot(x, y, marker, color=colour, markersize=3, linestyle="", label=label)
    for kind, marker in (("light", "*"), ("sign", "^")):
        places = np.array([(each.x, each.y) for each in road.signals if each.kind == kind])
        if places.size:
            x, y = _in_map(road, places).T
            label = f"{kind} ({len(places):,})"
            axes.plot(x, y, marker, color=SERIES[0], markersize=4, linestyle="", label=label)
    bridges = [_in_map(road, at[lane].points) for each in road.gaps for lane in each.bridge]
    if bridges:
        axes.add_collection(
            LineCollection(bridges, colors=SERIES[3], label=f"gap bridged ({len(road.gaps):,})")
        )
    axes.set_aspect("equal", adjustable="datalim")  # so that a straight road has room for text
    axes.autoscale_view()
    axes.set(xlabel="x of the map, m", ylabel="y of the map, m")
    axes.ticklabel_format(useOffset=False, style="plain")
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best", fontsize=7, frameon=False)
    axes.set_title(road.name, fontsize=9)
    return figure


def _in_map(road: RoadMap, points: Floats) -> Floats:
    """The points (N, 2) in the coordinates of the map."""
    return np.asarray(points[:, :2] * (1, -1) + road.origin)


def _area(lane: MapLane) -> Floats:
    """The outline of a lane."""
    points = lane.points
    way = np.gradient(points[:, :2], axis=0)
    normal = np.column_stack([-way[:, 1], way[:, 0]]) / np.hypot(*way.T)[:, None]
    half = points[:, 3, None] / 2 * normal
    return np.vstack([points[:, :2] + half, (points[:, :2] - half)[::-1]])


def _point(points: Floats, s: float) -> tuple[float, float]:
    """The point at a distance along points (N, 2 or more)."""
    along = lengths_of(points)
    x, y = (float(np.interp(s, along, points[:, k])) for k in range(2))
    return x, y


def _draw_arrows(axes: object, lines: list[Floats]) -> None:
    """An arrow in the middle of each lane, unless there are too many."""
    if len(lines) > _MOST_ARROWS:
        return
    middle = np.array([_middle(line) for line in lines])
    x, y, u, v = middle.T
    axes.quiver(  # type: ignore[attr-defined]
        x, y, u, v, angles="xy", color=EDGE, width=0.0015, scale=80, headwidth=6, pivot="mid"
    )


def _middle(line: Floats) -> tuple[float, float, float, float]:
    along = lengths_of(line)
    step = min(int(np.searchsorted(along, along[-1] / 2, side="right")), len(line) - 1)
    way = line[step] - line[step - 1]
    u, v = (way / np.hypot(*way)).tolist()
    return *_point(line, along[-1] / 2), u, v
