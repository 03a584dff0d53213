"""Which lanes of a network can be near, from a map of squares that is drawn once.

What decides is the distance of a lane plus the angle to it, which is at most pi. So a lane whose
distance is above that of another one by more than pi, everywhere in a square, cannot be nearest.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.compiled import compiled
from charms_bench.world.lane_geometry import CIRCULAR, END_MARGIN_M, POLYLINE, SINE
from charms_bench.world.road import NEIGHBOUR_MARGIN_M
from charms_bench.world.road_network import Network

SQUARE_M = 2.0
"""The side of a square, longer where there would be more than `SQUARES`."""
SQUARES = 2**16
AROUND_M = 20.0
"""How far the map reaches around the lanes."""
FAR_M = 150.0
"""Further away from all lanes than this, a vehicle asks all of them."""
FEW_LANES = 4
"""Of so many lanes, there is no map, since asking all of them is faster."""
_ROUNDING_M = 1e-6


def map_of(road: Network) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], int]:
    """The map of the lanes that can be the nearest ones, and of those on which a vehicle can be.

    The map's corner (x, y), squares per metre, columns and rows (5,); where the two lists begin
    (1 + S, 2) for a vehicle outside of the map and in each of S squares, row by row; the lists,
    each with -1 at its end; and on how many lanes a vehicle can be. The first list is of all lanes.
    """
    lanes = road.lanes.size
    everywhere = [*range(lanes), -1]
    if lanes <= FEW_LANES:
        return np.zeros(5), np.zeros((1, 2), np.int64), np.array(everywhere), lanes
    ends = np.array([_extent(road, row) for row in road.lanes])
    widest = np.array([_widest(road, row) for row in road.lanes])
    around = max(AROUND_M, widest.max() / 2 + END_MARGIN_M + NEIGHBOUR_MARGIN_M)
    low, high = ends[:, :2].min(axis=0) - around, ends[:, 2:].max(axis=0) + around
    side = max(SQUARE_M, math.sqrt(np.prod(high - low) / SQUARES))
    columns, rows = np.ceil((high - low) / side).astype(int).tolist()
    grid = _Grid(low, side, columns, rows)
    reach = side / math.sqrt(2) + _ROUNDING_M
    most = np.full((rows, columns), np.inf)
    for row, end in zip(road.lanes, ends, strict=True):
        part, x, y = grid.within(end, FAR_M)
        _, _, furthest = _bounds(road, row, x, y, reach)
        np.minimum(most[part], furthest.reshape(x.shape), out=most[part])
    is_near = np.isfinite(most)
    can_be_nearest, can_be_on = np.zeros((2, rows, columns, -(-lanes // 8)), dtype=np.uint8)
    furthest_of_all = float(most[is_near].max())
    for k, (row, end) in enumerate(zip(road.lanes, ends, strict=True)):
        # A polyline says that a point is up to its length closer than it is; see `_bounds`.
        closer = row["length"] if row["kind"] == POLYLINE else 0.0
        part, x, y = grid.within(end, furthest_of_all + math.pi + closer)
        aside, along, _ = (each.reshape(x.shape) for each in _bounds(road, row, x, y, reach))
        is_on = aside <= widest[k] / 2 + NEIGHBOUR_MARGIN_M + _ROUNDING_M
        is_on &= along <= END_MARGIN_M + _ROUNDING_M
        bit = np.uint8(128 >> k % 8)
        can_be_nearest[part][..., k // 8] |= bit * (
            aside + along <= most[part] + math.pi + _ROUNDING_M
        )
        can_be_on[part][..., k // 8] |= bit * is_on
    lists, first = [everywhere, [-1]], np.zeros((1 + rows * columns, 2), np.int64)
    first[0, 1] = len(everywhere)  # outside of the map, a vehicle is on no lane
    on_most = 1
    for n, bits in enumerate((can_be_nearest, can_be_on)):
        kinds, kind = np.unique(bits.reshape(rows * columns, -1), axis=0, return_inverse=True)
        members = np.unpackbits(kinds, axis=1, count=lanes)
        own = [[*np.nonzero(each)[0].tolist(), -1] for each in members]
        begins = np.cumsum([sum(map(len, lists)), *map(len, own)])
        first[1:, n] = begins[kind.ravel()]
        lists += own
        on_most = max(on_most, int(members.sum(axis=1).max())) if n else on_most
    first[1:, 0][~is_near.ravel()] = 0
    return (
        np.array([*low, 1 / side, columns, rows]),
        first,
        np.array([lane for each in lists for lane in each]),
        on_most,
    )


class _Grid(NamedTuple):
    """The squares of a map, row by row."""

    low: Floats
    side: float
    columns: int
    rows: int

    def within(self, extent: Floats, distance: float) -> tuple[Any, Floats, Floats]:
        """The squares (R, C) within a distance of an extent, with their centres' x and y."""
        ends = np.stack((extent[:2] - distance, extent[2:] + distance)) - self.low
        first, last = np.floor(ends / self.side).astype(int)
        last += 1
        (left, top), (right, bottom) = (
            np.clip(each, 0, (self.columns, self.rows)).tolist() for each in (first, last)
        )
        x = self.low[0] + (np.arange(left, right) + 0.5) * self.side
        y = self.low[1] + (np.arange(top, bottom) + 0.5) * self.side
        found = np.meshgrid(x, y)
        return np.s_[top:bottom, left:right], found[0], found[1]


def _widest(road: Network, row: Any) -> float:
    """The largest width of a lane."""
    if row["kind"] == POLYLINE:
        return float(road.curves["width"][row["curve"] :][: row["width_count"]].max())
    return float(row["width"])


def _extent(road: Network, row: Any) -> tuple[float, float, float, float]:
    """The least x and y of a lane, and the largest."""
    if row["kind"] == POLYLINE:
        points = road.curves[row["curve"] :][: row["point_count"]]
        x, y = points["x"], points["y"]
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())
    if row["kind"] == CIRCULAR:
        reach, end = row["radius"], (row["x"], row["y"])
    else:
        way = row["length"] * row["direction_x"], row["length"] * row["direction_y"]
        end, reach = (row["x"] + way[0], row["y"] + way[1]), abs(row["amplitude"])
    low_x, high_x = sorted((row["x"], end[0]))
    low_y, high_y = sorted((row["y"], end[1]))
    return low_x - reach, low_y - reach, high_x + reach, high_y + reach


def _bounds(
    road: Network, row: Any, x: Floats, y: Floats, reach: float
) -> tuple[Floats, Floats, Floats]:
    """Bounds of the distance of a lane within a reach of points.

    The least beside the lane, the least beyond its ends, and the largest of both together, which is
    that of `AbstractLane.distance`. Of a polyline, a position is measured from one of its poses,
    which can be as far away as the polyline is long.
    """
    if row["kind"] == POLYLINE:
        bounds = np.empty((3, x.size))
        _bounds_of_curve(row, road.curves, x.ravel(), y.ravel(), reach, bounds)
        return bounds[0], bounds[1], bounds[2]
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


@compiled
def _bounds_of_curve(
    row: Any, curves: Any, x: Floats, y: Floats, reach: float, bounds: Floats
) -> None:
    """Fills in the bounds (3, C) of a polyline; see `curve_coordinates`, which looks for a pose."""
    for c in range(x.size):
        aside, along, furthest = np.inf, np.inf, 0.0
        for k in range(row.pose_count - 1, -1, -1):
            pose = curves[row.curve + k]
            dx, dy = x[c] - pose.pose_x, y[c] - pose.pose_y
            ahead = pose.normal_x * dx + pose.normal_y * dy
            if ahead + reach < 0.0 and k > 0:
                continue  # no point within reach is measured from this pose
            beside, s = abs(-pose.normal_y * dx + pose.normal_x * dy), k + ahead
            aside = min(aside, max(beside - reach, 0.0))
            along = min(along, max(s - reach - row.length, 0.0 - s - reach, 0.0))
            beyond = max(s + reach - row.length, reach - s, 0.0)
            furthest = max(furthest, beside + reach + beyond)
            if ahead - reach >= 0.0:
                break  # every point is measured from this pose, or from one after it
        bounds[0, c], bounds[1, c], bounds[2, c] = aside, along, furthest


def _beyond(along: Floats, margin: Any, unit: float, length: float) -> Floats:
    """How far points are before or after a lane, with a margin; both in units."""
    after, before = (along + margin) * unit - length, (margin - along) * unit
    return np.asarray(np.maximum(np.maximum(after, before), 0.0))
