"""highway-env's observation `OccupancyGrid`: a grid of cells about the ego."""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.kinematics_observation import COS_D, X, Y, describe, describe_way
from charms_bench.roads.scenes import OBSTACLE, Row, Scenes
from charms_bench.world.kinematics_observation import FEATURES
from charms_bench.world.lane_geometry import CIRCULAR, STRAIGHT, line_coordinates, line_position
from charms_bench.world.scene import Observations

ON_ROAD = -1
"""The feature that is 1 where a lane is; the others are indices into `kinematics.FEATURES`."""
AROUND_M = 100.0
"""How far along a lane, before and after the ego, the lane is observed."""


class Grid(NamedTuple):
    """The grid in the ego's frame; SI units."""

    low_x: float
    low_y: float
    step_x: float
    step_y: float
    spacing: float
    """The distance of the points of a lane whose cells are on the road."""
    reach: float
    """The distance of the furthest corner."""
    is_aligned: bool
    """Whether the grid turns with the ego."""
    clips: bool
    is_image: bool


@compiled_of_scenes
def observe(
    scenes: Scenes,
    rows: Ints,
    ego_place: int,
    features: Ints,
    ranges: Floats,
    grid: Grid,
    out: Observations,
) -> None:
    """Writes an ego's observations (B, F, X, Y) of the scenes `rows` [`OccupancyGridObservation`].

    `features` (F,) are `ON_ROAD` or indices into `kinematics.FEATURES`, of which `ranges` (., 2)
    are mapped onto [-1, 1]; not a number where nothing is. Images are integers from 0 to 255.
    """
    values, has_more = np.empty(len(FEATURES)), features.max() >= COS_D
    for b in rows:
        ego = scenes.vehicles[b, ego_place]
        out[b] = 0.0
        for layer in range(features.size):
            if features[layer] == ON_ROAD:
                fill_road(scenes, ego, grid, out[b, layer])
        for m in range(scenes.vehicles.shape[1] - 1, -1, -1):
            j = scenes.order[b, m].place
            if scenes.vehicles[b, j].kind <= OBSTACLE:
                continue
            describe(scenes, b, j, ego_place, values)
            if has_more:
                describe_way(scenes, b, j, True, values)
            for f in range(len(FEATURES)):
                low, high = ranges[f]
                if not math.isnan(low):
                    values[f] = -1 + (values[f] - low) * 2 / (high - low)
            x, y = values[X], values[Y]
            if not math.isnan(ranges[X, 0]):
                x = ranges[X, 0] + (x - -1) * (ranges[X, 1] - ranges[X, 0]) / 2
            if not math.isnan(ranges[Y, 0]):
                y = ranges[Y, 0] + (y - -1) * (ranges[Y, 1] - ranges[Y, 0]) / 2
            i, k = cell_of(grid, x, y, ego.direction_x, ego.direction_y)
            if 0 <= i < out.shape[2] and 0 <= k < out.shape[3]:
                for layer in range(features.size):
                    if features[layer] != ON_ROAD:
                        out[b, layer, i, k] = shown(grid, values[features[layer]])


@compiled
def shown(grid: Grid, value: float) -> float:
    """The value of a cell as it is observed."""
    if grid.clips or grid.is_image:
        value = min(max(value, -1.0), 1.0)
    return math.floor((value + 1) / 2 * 255) if grid.is_image else value


@compiled
def cell_of(grid: Grid, x: float, y: float, cosine: float, sine: float) -> tuple[int, int]:
    """The cell of a point relative to the ego, whose direction is given [`pos_to_index`]."""
    if grid.is_aligned:
        x, y = cosine * x + sine * y, -sine * x + cosine * y
    return (math.floor((x - grid.low_x) / grid.step_x), math.floor((y - grid.low_y) / grid.step_y))


@compiled
def fill_road(scenes: Scenes, ego: Row, grid: Grid, layer: Floats) -> None:
    """Marks the cells with points of lanes [`fill_road_layer_by_lanes`].

    The points of a lane are those of `numpy.arange`, moved to the lane's ends where they are
    beyond. Points that are certainly outside the grid are left out.
    """
    lanes = scenes.road.lanes
    value = shown(grid, 1.0)
    for lane in range(lanes.size):
        row = lanes[lane]
        s, r = line_coordinates(row, ego.x, ego.y)
        near, far = s - AROUND_M, s + AROUND_M
        count = math.ceil((far - near) / grid.spacing)
        second = near + grid.spacing
        step = second - near
        low, high = 0.0, row.length
        if row.kind in (STRAIGHT, CIRCULAR) and abs(r) > grid.reach:
            continue
        if row.kind == STRAIGHT:
            low, high = max(low, s - grid.reach), min(high, s + grid.reach)
        first = max(math.floor((low - near) / step) - 1, 0)
        last = min(math.ceil((high - near) / step) + 1, count - 1)
        for k in range(first, last + 1):
            along = second if k == 1 else near + k * step
            along = min(max(along, 0.0), row.length)
            x, y = line_position(row, along, 0.0)
            i, j = cell_of(grid, x - ego.x, y - ego.y, ego.direction_x, ego.direction_y)
            if 0 <= i < layer.shape[0] and 0 <= j < layer.shape[1]:
                layer[i, j] = value
