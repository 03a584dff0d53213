"""Parallel straight lanes along x, as on a motorway: the rules of `world.road` for them.

Compiled code calls these functions with numbers, other code with arrays too.
"""

from typing import Any, NamedTuple

from numba.extending import register_jitable

from charms_bench.foundation.compiled import compiled, wrap_to_pi

NEIGHBOUR_MARGIN_M = 1.0
"""How far beside a lane a vehicle's centre still makes it a neighbour on that lane."""
END_MARGIN_M = 5.0
"""How far before and after a lane's ends a vehicle's centre is still on the lane, whatever the
vehicle's length [`AbstractLane.VEHICLE_LENGTH`]."""


class Straight(NamedTuple):
    """Lane 0 is the leftmost and its centre is y = 0; x runs from 0 to the road's length. SI units.

    `Constants` has the same fields, so the constants of a scene are a straight road too.
    """

    lanes: int
    lane_width: float
    road_length: float
    speed_limit: float


@register_jitable
def position(road: Any, lane: Any, longitudinal: Any, lateral: Any) -> Any:
    return longitudinal, lane * road.lane_width + lateral


@register_jitable
def heading_at(road: Any, lane: Any, longitudinal: Any) -> Any:
    return 0.0


@register_jitable
def width_at(road: Any, lane: Any, longitudinal: Any) -> Any:
    return road.lane_width


@register_jitable
def local_coordinates(road: Any, lane: Any, x: Any, y: Any) -> Any:
    return x, y - lane * road.lane_width


@register_jitable
def is_on_lane(road: Any, lane: Any, x: Any, y: Any, margin: Any) -> Any:
    return is_on_length(road, x) & is_near_lane(road, lane, y, margin)


@register_jitable
def is_on_length(road: Any, x: Any) -> Any:
    """The part of `is_on_lane` that is the same for every lane."""
    return (x >= -END_MARGIN_M) & (x < road.road_length + END_MARGIN_M)


@register_jitable
def is_near_lane(road: Any, lane: Any, y: Any, margin: Any = NEIGHBOUR_MARGIN_M) -> Any:
    """The part of `is_on_lane` that depends on the lane."""
    return abs(y - lane * road.lane_width) <= road.lane_width / 2 + margin


@register_jitable
def is_reachable(road: Any, lane: Any, x: Any, y: Any) -> Any:
    exists = (lane >= 0) & (lane < road.lanes)
    on_length = (x >= 0) & (x < road.road_length + END_MARGIN_M)
    return exists & on_length & (abs(y - lane * road.lane_width) <= 2 * road.lane_width)


@register_jitable
def is_after_end(road: Any, lane: Any, x: Any, y: Any) -> Any:
    return x > road.road_length - END_MARGIN_M / 2


@register_jitable
def distance(road: Any, lane: Any, x: Any, y: Any) -> Any:
    beyond = max(x - road.road_length, 0.0)
    return abs(y - lane * road.lane_width) + beyond + max(0.0 - x, 0.0)


@register_jitable
def distance_with_heading(road: Any, lane: Any, x: Any, y: Any, heading: Any) -> Any:
    return distance(road, lane, x, y) + abs(wrap_to_pi(heading))


@register_jitable
def closest_lane(road: Any, x: Any, y: Any, heading: Any) -> Any:
    """What all lanes have in common, the distance beyond the ends and the heading, is left out."""
    return first_nearest(y, road.lanes, road.lane_width)


@compiled
def first_nearest(y: float, lanes: int, lane_width: float) -> int:
    """The lane whose centre is nearest to y; of two that are equally near, the left one."""
    best = 0
    nearest = abs(y)
    for lane in range(1, lanes):
        other = abs(y - lane * lane_width)
        if other < nearest:
            best = lane
            nearest = other
    return best


@register_jitable
def next_lane(road: Any, lane: Any, next_road: Any, next_lane_id: Any, x: Any, y: Any) -> Any:
    return lane


@register_jitable
def side_lanes(road: Any, lane: Any) -> Any:
    return lane - 1, lane + 1 if lane + 1 < road.lanes else -1
