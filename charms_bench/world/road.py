"""What the code asks a road: where its lanes are, which lane a vehicle is on and can reach.

Each question is written here with its answer for parallel straight lanes. For a network, compiled
code and Python call the function of the same name in `road_network` instead; compiled code chooses
by the type of the road when it is compiled. Lanes are indices; units are SI. On a straight road,
the questions take arrays too.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple, TypeVar, cast

from numba.extending import overload, register_jitable

from charms_bench.foundation.compiled import compiled, wrap_to_pi
from charms_bench.world import road_network
from charms_bench.world.lane_geometry import END_MARGIN_M
from charms_bench.world.road_network import Network

NEIGHBOUR_MARGIN_M = 1.0
"""How far beside a lane a vehicle's centre still makes it a neighbour on that lane."""


class Straight(NamedTuple):
    """Lane 0 is the leftmost and its centre is y = 0; x runs from 0 to the road's length."""

    lanes: int
    lane_width: float
    road_length: float
    speed_limit: float


Road = Straight | Network
F = TypeVar("F", bound=Callable[..., Any])


def _of_roads(answer: F) -> F:
    """A question to any road, from its answer for a straight road."""
    of_network = getattr(road_network, answer.__name__)

    @wraps(answer)
    def question(road: Road, *others: Any) -> Any:
        return (of_network if isinstance(road, Network) else answer)(road, *others)

    def chosen(road: Any, *others: Any) -> Any:
        return of_network if road.instance_class is Network else answer

    overload(question, strict=False, jit_options={"forceinline": True})(chosen)
    return cast(F, question)


@_of_roads
def position(road: Any, lane: Any, longitudinal: Any, lateral: Any) -> Any:
    """The point (x, y) that lies so far along and beside a lane [`AbstractLane.position`]."""
    return longitudinal, lane * road.lane_width + lateral


@_of_roads
def heading_at(road: Any, lane: Any, longitudinal: Any) -> Any:
    """The lane's heading, rad, not normalised [`AbstractLane.heading_at`]."""
    return 0.0


@_of_roads
def width_at(road: Any, lane: Any, longitudinal: Any) -> Any:
    """The lane's width [`AbstractLane.width_at`]."""
    return road.lane_width


@_of_roads
def local_coordinates(road: Any, lane: Any, x: Any, y: Any) -> Any:
    """How far a point is along and beside a lane [`AbstractLane.local_coordinates`]."""
    return x, y - lane * road.lane_width


@_of_roads
def distance_along(road: Any, lane: Any, x: Any, y: Any, other_x: Any, other_y: Any) -> Any:
    """How far another point is ahead of a point along a lane [`RoadObject.lane_distance_to`]."""
    return other_x - x


@_of_roads
def is_on_lane(road: Any, lane: Any, x: Any, y: Any, margin: Any) -> Any:
    """Whether a vehicle is on a lane [`AbstractLane.on_lane`].

    Its centre must be at most `END_MARGIN_M` beyond the lane's ends, and within half the lane's
    width and a margin of its centre. With `NEIGHBOUR_MARGIN_M`, a vehicle can be on two lanes.
    """
    return is_on_length(road, x) & is_near_lane(road, lane, y, margin)


@register_jitable
def is_on_length(road: Any, x: Any) -> Any:
    """The part of `is_on_lane` that is the same for every lane of a straight road."""
    return (x >= -END_MARGIN_M) & (x < road.road_length + END_MARGIN_M)


@register_jitable
def is_near_lane(road: Any, lane: Any, y: Any, margin: Any = NEIGHBOUR_MARGIN_M) -> Any:
    """The part of `is_on_lane` that depends on the lane of a straight road."""
    return abs(y - lane * road.lane_width) <= road.lane_width / 2 + margin


@_of_roads
def is_reachable(road: Any, lane: Any, x: Any, y: Any) -> Any:
    """Whether a lane exists and a vehicle may change to it [`AbstractLane.is_reachable_from`]."""
    exists = (lane >= 0) & (lane < road.lanes)
    on_length = (x >= 0) & (x < road.road_length + END_MARGIN_M)
    return exists & on_length & (abs(y - lane * road.lane_width) <= 2 * road.lane_width)


@_of_roads
def distance(road: Any, lane: Any, x: Any, y: Any) -> Any:
    """How far a point is from a lane, beside it and along it [`AbstractLane.distance`]."""
    beyond = max(x - road.road_length, 0.0)
    return abs(y - lane * road.lane_width) + beyond + max(0.0 - x, 0.0)


@_of_roads
def distance_with_heading(road: Any, lane: Any, x: Any, y: Any, heading: Any) -> Any:
    """The distance, m, plus the angle to the lane, rad [`AbstractLane.distance_with_heading`]."""
    return distance(road, lane, x, y) + abs(wrap_to_pi(heading))


@_of_roads
def closest_lane(road: Any, x: Any, y: Any, heading: Any) -> Any:
    """The first lane at the least distance with heading [`get_closest_lane_index`].

    On a straight road, what all lanes have in common is left out.
    """
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


@_of_roads
def next_lane(road: Any, lane: Any, next_road: Any, next_id: Any, x: Any, y: Any) -> Any:
    """The lane after a lane's end, or the lane itself if none follows [`RoadNetwork.next_lane`].

    `next_road` is the first lane of the next road on the vehicle's route, -1 without a route, for
    which the lane nearest to x, y is chosen; `next_id` is the lane's number on that road, -1 if the
    route does not say.
    """
    return lane


@_of_roads
def side_lanes(road: Any, lane: Any) -> Any:
    """The lanes on the left and on the right, -1 for none [`RoadNetwork.side_lanes`]."""
    return lane - 1, lane + 1 if lane + 1 < road.lanes else -1
