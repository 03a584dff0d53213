"""highway-env's rules of which lane a vehicle is on and which lane it can reach.

Each rule is written once: compiled code calls it with numbers, other code with arrays.
"""

from typing import Any

from numba.extending import register_jitable

from charms_bench.foundation.compiled import compiled
from charms_bench.world.profile import Constants

NEIGHBOUR_MARGIN_M = 1.0
"""How far beside a lane a vehicle's centre still makes it a neighbour on that lane."""
END_MARGIN_M = 5.0
"""How far before and after a road's ends a vehicle's centre is still on the road, whatever the
vehicle's length [`AbstractLane.VEHICLE_LENGTH`]."""


@register_jitable
def is_on_lane(x: Any, y: Any, lane: Any, c: Constants, margin: float = NEIGHBOUR_MARGIN_M) -> Any:
    """Whether a vehicle is on a lane [`AbstractLane.on_lane`].

    Its centre must be at most `END_MARGIN_M` beyond the road's ends, and within half a lane and a
    margin of the lane's centre. With the default margin, a vehicle can be on two lanes.
    """
    return is_on_length(x, c) & is_near_lane(y, lane, c, margin)


@register_jitable
def is_on_length(x: Any, c: Constants) -> Any:
    """The part of `is_on_lane` that is the same for every lane."""
    return (x >= -END_MARGIN_M) & (x < c.road_length + END_MARGIN_M)


@register_jitable
def is_near_lane(y: Any, lane: Any, c: Constants, margin: float = NEIGHBOUR_MARGIN_M) -> Any:
    """The part of `is_on_lane` that depends on the lane."""
    return abs(y - lane * c.lane_width) <= c.lane_width / 2 + margin


@register_jitable
def is_reachable(x: Any, y: Any, lane: Any, c: Constants) -> Any:
    """Whether a lane exists and a vehicle may change to it [`AbstractLane.is_reachable_from`]."""
    exists = (lane >= 0) & (lane < c.lanes)
    on_length = (x >= 0) & (x < c.road_length + END_MARGIN_M)
    return exists & on_length & (abs(y - lane * c.lane_width) <= 2 * c.lane_width)


@compiled
def closest_lane(y: float, lanes: int, lane_width: float) -> int:
    """`RoadNetwork.get_closest_lane_index` on parallel straight lanes: the first nearest."""
    best = 0
    distance = abs(y)
    for lane in range(1, lanes):
        other = abs(y - lane * lane_width)
        if other < distance:
            best = lane
            distance = other
    return best
