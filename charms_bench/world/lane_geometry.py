"""The geometry of one lane of a network, by its kind, operation for operation as in highway-env.

The functions take a row of the table of lanes, which compiled code passes as a pointer. Those of
polylines also take the table of curves: as an array, which is why they are compiled into their
callers (to pass it takes longer than to compute the answer), or as its first row, a pointer.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, compiled, inlined, row_after, wrap_to_pi

KINDS = ("straight", "sine", "circular", "polyline")
"""The kinds of lanes; a lane's `kind` is an index into this tuple."""
STRAIGHT, SINE, CIRCULAR, POLYLINE = range(len(KINDS))

_COLUMNS = "arc_length x y pose_x pose_y normal_x normal_y heading width"
CURVE = np.dtype((np.record, [(name, "f8") for name in _COLUMNS.split()]))
"""A row of the table of curves. It holds three things that have no more in common than their
number along the same polyline: one of its points with the length of the polyline up to it; the
position and the direction of the polyline at a whole number of metres [`CurvePose`]; and the lane's
width [`PolyLane.width_samples`]."""
END_MARGIN_M = 5.0
"""How far before and after a lane's ends a vehicle's centre is still on the lane, whatever the
vehicle's length [`AbstractLane.VEHICLE_LENGTH`]."""
Row = Any
"""A row of the table of lanes; see `road_network.LANE`."""
Curves = NDArray[np.void] | Any
"""The table of curves, or its first row in compiled code."""
Pair = tuple[float, float]


@compiled
def line_position(lane: Row, longitudinal: float, lateral: float) -> Pair:
    """[`position` of `StraightLane`, `SineLane` and `CircularLane`]"""
    if lane.kind == CIRCULAR:
        phi = lane.turn * longitudinal / lane.radius + lane.start_phase
        sine, cosine = maths.sin_cos(phi)
        reach = lane.radius - lateral * lane.turn
        return lane.x + reach * cosine, lane.y + reach * sine
    if lane.kind == SINE:
        lateral += lane.amplitude * maths.sin(lane.pulsation * longitudinal + lane.phase)
    return (
        lane.x + longitudinal * lane.direction_x + lateral * -lane.direction_y,
        lane.y + longitudinal * lane.direction_y + lateral * lane.direction_x,
    )


@compiled
def line_heading(lane: Row, longitudinal: float) -> float:
    """[`heading_at` of `StraightLane`, `SineLane` and `CircularLane`]"""
    if lane.kind == CIRCULAR:
        phi = lane.turn * longitudinal / lane.radius + lane.start_phase
        return float(phi + math.pi / 2 * lane.turn)
    if lane.kind == SINE:
        cosine = maths.cos(lane.pulsation * longitudinal + lane.phase)
        return float(lane.heading + maths.atan(lane.amplitude * lane.pulsation * cosine))
    return float(lane.heading)


@compiled
def line_coordinates(lane: Row, x: float, y: float) -> Pair:
    """[`local_coordinates` of `StraightLane`, `SineLane` and `CircularLane`]"""
    aside_x, aside_y = x - lane.x, y - lane.y
    if lane.kind == CIRCULAR:
        phi = maths.atan2(aside_y, aside_x)
        phi = lane.start_phase + wrap_to_pi(phi - lane.start_phase)
        reach = math.sqrt(aside_x * aside_x + aside_y * aside_y)
        return lane.turn * (phi - lane.start_phase) * lane.radius, lane.turn * (lane.radius - reach)
    longitudinal = aside_x * lane.direction_x + aside_y * lane.direction_y
    lateral = aside_x * -lane.direction_y + aside_y * lane.direction_x
    if lane.kind == SINE:
        lateral -= lane.amplitude * maths.sin(lane.pulsation * longitudinal + lane.phase)
    return longitudinal, lateral


def curve_row(curves: Curves, k: int) -> Any:
    """The row k of the table of curves."""
    return curves[k]


@overload(curve_row, inline="always", strict=False)
def _curve_row(curves: Any, k: Any) -> Any:
    if isinstance(curves, types.Record):
        return lambda curves, k: row_after(curves, k)
    return lambda curves, k: curves[k]


@inlined
def curve_position(lane: Row, curves: Curves, longitudinal: float, lateral: float) -> Pair:
    """[`PolyLaneFixedWidth.position`, with `numpy_interp1d`]"""
    low, last = lane.curve, lane.curve + lane.point_count - 1
    high = last
    while high - low > 1:
        middle = (low + high) // 2
        if curve_row(curves, middle).arc_length <= longitudinal:
            low = middle
        else:
            high = middle
    one, other = curve_row(curves, low), curve_row(curves, low + 1)
    known = curve_row(curves, last) if longitudinal >= curve_row(curves, last).arc_length else one
    span, along = other.arc_length - one.arc_length, longitudinal - known.arc_length
    x = known.x + (other.x - one.x) / span * along
    y = known.y + (other.y - one.y) / span * along
    sine, cosine = maths.sin_cos(curve_heading(lane, curves, longitudinal))
    return x - sine * lateral, y + cosine * lateral


@inlined
def curve_heading(lane: Row, curves: Curves, longitudinal: float) -> float:
    """[`PolyLaneFixedWidth.heading_at`]"""
    metre = int(clip(longitudinal, 0.0, lane.pose_count - 1.0))
    return float(curve_row(curves, lane.curve + metre).heading)


@inlined
def curve_width(lane: Row, curves: Curves, longitudinal: float) -> float:
    """[`PolyLane.width_at`]"""
    metre = int(clip(longitudinal, 0.0, lane.width_count - 1.0))
    return float(curve_row(curves, lane.curve + metre).width)


@inlined
def curve_coordinates(lane: Row, curves: Curves, x: float, y: float) -> Pair:
    """[`LinearSpline2D.cartesian_to_frenet`]"""
    metres = lane.pose_count
    ahead = -1.0
    while ahead < 0.0 and metres > 0:
        metres -= 1
        pose = curve_row(curves, lane.curve + metres)
        aside_x, aside_y = x - pose.pose_x, y - pose.pose_y
        ahead = pose.normal_x * aside_x + pose.normal_y * aside_y
    pose = curve_row(curves, lane.curve + metres)
    aside_x, aside_y = x - pose.pose_x, y - pose.pose_y
    return metres + ahead, -pose.normal_y * aside_x + pose.normal_x * aside_y
