"""Which lanes of a network can be near, from a map of squares that is drawn once.

What decides is the distance of a lane plus the angle to it, which is at most pi. So a lane whose
distance is above that of another one by more than pi, everywhere in a square, cannot be nearest.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Bools, Floats
from charms_bench.world.lane_geometry import CIRCULAR, END_MARGIN_M, SINE
from charms_bench.world.road import NEIGHBOUR_MARGIN_M
from charms_bench.world.road_network import Network

SQUARE_M = 2.0
"""The side of a square, longer where there would be more than `SQUARES`."""
SQUARES = 2**16
AROUND_M = 20.0
"""How far the map reaches around the lanes."""
FEW_LANES = 4
"""Of so many lanes, there is no map, since asking all of them is faster."""
_ROUNDING_M = 1e-6


def map_of(road: Network) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], int]:
    """The map of the lanes that can be the nearest ones, and of those on which a vehicle can be.

    Returns:
        The map's corner (x, y), squares per metre, columns and rows (5,); where the two lists begin
        (1 + S, 2) for a vehicle outside of the map and in each of S squares, row by row; the lists,
        each with -1 at its end; and on how many lanes a vehicle can be. The first list is of all
        lanes.
    """
    lanes = road.lanes.size
    everywhere = [*range(lanes), -1]
    if lanes <= FEW_LANES:
        return np.zeros(5), np.zeros((1, 2), np.int64), np.array(everywhere), lanes
    ends = np.array([_extent(row) for row in road.lanes])
    around = max(AROUND_M, road.lanes["width"].max() / 2 + END_MARGIN_M + NEIGHBOUR_MARGIN_M)
    low, high = ends[:, :2].min(axis=0) - around, ends[:, 2:].max(axis=0) + around
    side = max(SQUARE_M, math.sqrt(np.prod(high - low) / SQUARES))
    columns, rows = np.ceil((high - low) / side).astype(int)
    x = np.tile(low[0] + (np.arange(columns) + 0.5) * side, rows)
    y = np.repeat(low[1] + (np.arange(rows) + 0.5) * side, columns)
    reach = side / math.sqrt(2) + _ROUNDING_M
    least = np.empty((lanes, x.size))
    most = np.full(x.size, np.inf)
    can_be_on = np.empty((x.size, lanes), dtype=np.bool_)
    for k, row in enumerate(road.lanes):
        aside, along, furthest = _bounds(row, x, y, reach)
        least[k] = aside + along
        np.minimum(most, furthest, out=most)
        widest = row["width"] / 2 + NEIGHBOUR_MARGIN_M + _ROUNDING_M
        can_be_on[:, k] = (aside <= widest) & (along <= END_MARGIN_M + _ROUNDING_M)
    can_be_nearest: Bools = (least <= most + math.pi + _ROUNDING_M).T
    lists, first = [everywhere, [-1]], np.zeros((1 + x.size, 2), np.int64)
    first[0, 1] = len(everywhere)  # outside of the map, a vehicle is on no lane
    for n, can_be in enumerate((can_be_nearest, can_be_on)):
        kinds, kind = np.unique(np.packbits(can_be, axis=1), axis=0, return_inverse=True)
        members = np.unpackbits(kinds, axis=1, count=lanes)
        own = [[*np.nonzero(each)[0].tolist(), -1] for each in members]
        begins = np.cumsum([sum(map(len, lists)), *map(len, own)])
        first[1:, n] = begins[kind.ravel()]
        lists += own
    on_most = max(int(can_be_on.sum(axis=1).max()), 1)
    return (
        np.array([*low, 1 / side, columns, rows]),
        first,
        np.array([lane for each in lists for lane in each]),
        on_most,
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


def _bounds(row: Any, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats, Floats]:
    """Bounds of the distance of a lane within a reach of points (C,).

    Returns:
        The least distance beside the lane, the least beyond its ends, and the largest of both
        together, which is that of `AbstractLane.distance`.
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
        return np.maximum(aside - reach, 0.0), least, aside + reach + most
    s = dx * row["direction_x"] + dy * row["direction_y"]
    aside = np.abs(dy * row["direction_x"] - dx * row["direction_y"])
    swing = reach + (abs(row["amplitude"]) if row["kind"] == SINE else 0.0)
    least, most = (_beyond(s, sign * reach, 1.0, row["length"]) for sign in (-1, 1))
    return np.maximum(aside - swing, 0.0), least, aside + swing + most


def _beyond(along: Floats, margin: Any, unit: float, length: float) -> Floats:
    """How far points are before or after a lane, with a margin; both in units."""
    after, before = (along + margin) * unit - length, (margin - along) * unit
    return np.asarray(np.maximum(np.maximum(after, before), 0.0))
