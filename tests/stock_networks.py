"""highway-env's own roads as tables."""

from collections.abc import Callable
from dataclasses import fields
from inspect import getclosurevars
from typing import Any

from charms_bench.world import road_network


def road_of(network: Any) -> road_network.Network:
    """The road for a `RoadNetwork` of highway-env; its lanes are in the order of `lanes_list`."""
    lanes = network.lanes_dict().items()
    return road_network.network_of(
        (start, end, _description(lane)) for (start, end, _), lane in lanes
    )


def _description(lane: Any) -> road_network.Lane:
    """The description that has the same fields as one of highway-env's lanes."""
    is_polyline = hasattr(lane, "curve")
    kind: Any = road_network.PolyLane if is_polyline else getattr(road_network, type(lane).__name__)
    values = {**vars(lane), "line_types": lane.line_types or (1, 1)}
    if is_polyline:
        points = map(_values, (lane.curve.x_curve, lane.curve.y_curve))
        values["points"] = tuple(zip(*points, strict=True))
        values["widths"] = tuple(values.get("width_samples", ()))
    described: road_network.Lane = kind(**{each.name: values[each.name] for each in fields(kind)})
    return described


def _values(interpolated: Callable[[float], float]) -> list[float]:
    """The values that one of highway-env's functions interpolates [`numpy_interp1d`]."""
    return list(map(float, getclosurevars(interpolated).nonlocals["y"]))
