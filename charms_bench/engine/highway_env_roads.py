"""Turns the project's roads into networks of highway-env, and those into the project's roads."""

from collections.abc import Callable
from dataclasses import fields
from inspect import getclosurevars
from typing import Any

import numpy as np
from highway_env.road import lane as highway_env_lanes
from highway_env.road.road import RoadNetwork

from charms_bench.world import road_network
from charms_bench.world.road import Straight
from charms_bench.world.road_network import Network, PolyLane, network_of


def highway_env_network(road: Straight) -> RoadNetwork:
    """highway-env's network of a straight road [`HighwayEnv._create_road`]."""
    network, width = RoadNetwork(), road.lane_width
    for lane in range(road.lanes):
        ends = np.array([[0.0, lane * width], [road.road_length, lane * width]])
        straight = highway_env_lanes.StraightLane(*ends, width=width, speed_limit=road.speed_limit)
        network.add_lane("0", "1", straight)
    return network


def road_of(network: RoadNetwork) -> Network:
    """The project's road for a network of highway-env; its lanes are those of `lanes_list`."""
    lanes = network.lanes_dict().items()
    return network_of((start, end, _description(lane)) for (start, end, _), lane in lanes)


def _description(lane: highway_env_lanes.AbstractLane) -> road_network.Lane:
    """The description that has the same fields as one of highway-env's lanes."""
    is_polyline = isinstance(lane, highway_env_lanes.PolyLaneFixedWidth)
    kind: Any = PolyLane if is_polyline else getattr(road_network, type(lane).__name__)
    values = {**vars(lane), "line_types": lane.line_types or (1, 1)}
    if is_polyline:
        values["points"] = tuple(
            zip(*map(_values, (lane.curve.x_curve, lane.curve.y_curve)), strict=True)
        )
        values["widths"] = tuple(values.get("width_samples", ()))
    described: road_network.Lane = kind(**{each.name: values[each.name] for each in fields(kind)})
    return described


def _values(interpolated: Callable[[float], float]) -> list[float]:
    """The values that one of highway-env's functions interpolates [`numpy_interp1d`]."""
    return list(map(float, getclosurevars(interpolated).nonlocals["y"]))
