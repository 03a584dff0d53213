"""Which lanes of a network can be the nearest one, from a map of squares that is drawn once.

What decides is the distance of a lane plus the angle to it, which is at most pi. So a lane whose
distance is above that of another one by more than pi, everywhere in a square, cannot be nearest.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Bools, Floats
from charms_bench.world.lane_geometry import CIRCULAR, SINE
from charms_bench.world.road_network import Network

SQUARE_M = 2.0
"""The side of a square, longer where there would be more than `SQUARES`."""
SQUARES = 2**16
AROUND_M = 20.0
"""How far the map reaches around the lanes."""
FEW_LANES = 4
"""Of so many lanes, there is no map, since asking all of them is faster."""
_ROUNDING_M = 1e-6
Bounds = tuple[Floats, Floats]


def map_of(road: Network) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
    """The map of the lanes that can be the nearest ones.

    Returns:
        The map's corner (x, y), squares per metre, columns and rows (5,); for each square, row by
        row, where its list begins; and the lists, each with -1 at its end. The first is of all
        lanes.
    """
    everywhere = [*range(road.lanes.size), -1]
    if road.lanes.size <= FEW_LANES:
        return np.zeros(5), np.zeros(1, np.int64), np.array(everywhere)
    ends = np.array([_extent(row) for row in road.lanes])
    low, high = ends[:, :2].min(axis=0) - AROUND_M, ends[:, 2:].max(axis=0) + AROUND_M
    side = max(SQUARE_M, math.sqrt(np.prod(high - low) / SQUARES))
    columns, rows = np.ceil((high - low) / side).astype(int)
    x = np.tile(low[0] + (np.arange(columns) + 0.5) * side, rows)
    y = np.repeat(low[1] + (np.arange(rows) + 0.5) * side, columns)
    reach = side / math.sqrt(2) + _ROUNDING_M
    bounds = [_bounds(row, x, y, reach) for row in road.lanes]
    least, most = (np.stack(each) for each in zip(*bounds, strict=True))
    can_be: Bools = (least <= most.min(axis=0) + math.pi + _ROUNDING_M).T
    kinds, kind = np.unique(np.packbits(can_be, axis=1), axis=0, return_inverse=True)
    members = np.unpackbits(kinds, axis=1, count=road.lanes.size)
    lists = [np.append(np.nonzero(each)[0], -1) for each in members]
    begins = np.cumsum([len(everywhere), *map(len, lists)])
    return (
        np.array([*low, 1 / side, columns, rows]),
        begins[kind.ravel()],
        np.concatenate([everywhere, *lists]),
    )


def _extent(row: Any) -> tuple[float, float, float, float]:
    """The least x and y of a lane, and the largest."""
    if row["kind"] == CIRCULAR:
        reach, end = row["radius"], (row["x"], row["y"])
    else:
        way = row["length"] * row["direction_x"], row["length"] * row["direction_y"]
        end, reach = (row["x"] + way[0], row["y"] + way[1]), abs(row["amplitude"])
    low_x, high_x = sorted((row["x"], end[0]))
    low_y, high_y = sorted((row["y"], end[1]))
    return low_x - reach, low_y - reach, high_x + reach, high_y + reach


def _bounds(row: Any, x: Floats, y: Floats, reach: float) -> Bounds:
    """The least and the largest distance of a lane within a reach of points (C,).

    The distance is that of `AbstractLane.distance`.
    """
    dx, dy = x - row["x"], y - row["y"]
    if row["kind"] == CIRCULAR:
        away = np.sqrt(dx * dx + dy * dy)
        turn = (np.arctan2(dy, dx) - row["start_phase"] + math.pi) % (2 * math.pi) - math.pi
        # An arcsine is at most pi / 2 times its argument.
        angle = math.pi / 2 * reach / np.maximum(away, 1e-9)
        is_unclear = (away < 2 * reach) | (np.abs(turn) + angle > math.pi)
        aside, along, length = np.abs(row["radius"] - away), turn * row["turn"], row["length"]
        least = np.where(is_unclear, 0.0, _beyond(along, -angle, row["radius"], length))
        most = np.where(is_unclear, np.inf, _beyond(along, angle, row["radius"], length))
        return np.maximum(aside - reach, 0.0) + least, aside + reach + most
    s = dx * row["direction_x"] + dy * row["direction_y"]
    aside = np.abs(dy * row["direction_x"] - dx * row["direction_y"])
    swing = reach + (abs(row["amplitude"]) if row["kind"] == SINE else 0.0)
    least, most = (_beyond(s, sign * reach, 1.0, row["length"]) for sign in (-1, 1))
    return np.maximum(aside - swing, 0.0) + least, aside + swing + most


def _beyond(along: Floats, margin: Any, unit: float, length: float) -> Floats:
    """How far points are before or after a lane, with a margin; both in units."""
    after, before = (along + margin) * unit - length, (margin - along) * unit
    return np.asarray(np.maximum(np.maximum(after, before), 0.0))
