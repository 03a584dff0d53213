"""What the code asks a road: where its lanes are, which lane a vehicle is on and can reach.

Each question compiles to the rule for the type of the road, `straight_road` or `road_network`; the
choice costs nothing when compiled code runs. Lanes are indices. Positions, SI units, are those of
vehicles' centres in the world (x, y) or along and beside a lane (longitudinal, lateral).
"""

from collections.abc import Callable
from types import ModuleType
from typing import Any, TypeVar

from numba.extending import overload

from charms_bench.world import road_network, straight_road
from charms_bench.world.profile import Constants
from charms_bench.world.road_network import Network
from charms_bench.world.straight_road import Straight

Road = Straight | Constants | Network
F = TypeVar("F", bound=Callable[..., Any])


def _rules(road_type: type) -> ModuleType:
    return road_network if road_type is Network else straight_road


def _by_type(question: F) -> F:
    """Makes compiled code call the rule of the same name for the type of the first argument."""

    def rule(road: Any, *others: Any) -> Any:
        return getattr(_rules(road.instance_class), question.__name__)

    overload(question, strict=False, jit_options={"forceinline": True})(rule)
    return question


@_by_type
def position(road: Road, lane: Any, longitudinal: Any, lateral: Any) -> Any:
    """The point (x, y) that lies so far along and beside a lane [`AbstractLane.position`]."""
    return _rules(type(road)).position(road, lane, longitudinal, lateral)


@_by_type
def heading_at(road: Road, lane: Any, longitudinal: Any) -> Any:
    """The lane's heading, rad, not normalised [`AbstractLane.heading_at`]."""
    return _rules(type(road)).heading_at(road, lane, longitudinal)


@_by_type
def width_at(road: Road, lane: Any, longitudinal: Any) -> Any:
    """The lane's width [`AbstractLane.width_at`]."""
    return _rules(type(road)).width_at(road, lane, longitudinal)


@_by_type
def local_coordinates(road: Road, lane: Any, x: Any, y: Any) -> Any:
    """How far a point is along and beside a lane [`AbstractLane.local_coordinates`]."""
    return _rules(type(road)).local_coordinates(road, lane, x, y)


@_by_type
def is_on_lane(road: Road, lane: Any, x: Any, y: Any, margin: Any) -> Any:
    """Whether a vehicle is on a lane [`AbstractLane.on_lane`].

    Its centre must be at most `END_MARGIN_M` beyond the lane's ends, and within half the lane's
    width and a margin of its centre. With `NEIGHBOUR_MARGIN_M`, a vehicle can be on two lanes.
    """
    return _rules(type(road)).is_on_lane(road, lane, x, y, margin)


@_by_type
def is_reachable(road: Road, lane: Any, x: Any, y: Any) -> Any:
    """Whether a lane exists and a vehicle may change to it [`AbstractLane.is_reachable_from`]."""
    return _rules(type(road)).is_reachable(road, lane, x, y)


@_by_type
def is_after_end(road: Road, lane: Any, x: Any, y: Any) -> Any:
    """Whether a vehicle is about to leave a lane at its end [`AbstractLane.after_end`]."""
    return _rules(type(road)).is_after_end(road, lane, x, y)


@_by_type
def distance(road: Road, lane: Any, x: Any, y: Any) -> Any:
    """How far a point is from a lane, along it and beside it [`AbstractLane.distance`]."""
    return _rules(type(road)).distance(road, lane, x, y)


@_by_type
def distance_with_heading(road: Road, lane: Any, x: Any, y: Any, heading: Any) -> Any:
    """The distance, m, plus the angle to the lane, rad [`AbstractLane.distance_with_heading`]."""
    return _rules(type(road)).distance_with_heading(road, lane, x, y, heading)


@_by_type
def closest_lane(road: Road, x: Any, y: Any, heading: Any) -> Any:
    """The first lane at the least distance with heading [`get_closest_lane_index`]."""
    return _rules(type(road)).closest_lane(road, x, y, heading)


@_by_type
def next_lane(road: Road, lane: Any, next_road: Any, next_id: Any, x: Any, y: Any) -> Any:
    """The lane after a lane's end, or the lane itself if none follows [`RoadNetwork.next_lane`].

    Args:
        road: The road.
        lane: The present lane.
        next_road: The first lane of the next road on the vehicle's route; -1 without a route, for
            which the nearest lane is chosen.
        next_id: The lane's number on that road; -1 if the route does not say.
        x: The vehicle's position.
        y: The same.
    """
    return _rules(type(road)).next_lane(road, lane, next_road, next_id, x, y)


@_by_type
def side_lanes(road: Road, lane: Any) -> Any:
    """The lanes on the left and on the right, -1 for none [`RoadNetwork.side_lanes`]."""
    return _rules(type(road)).side_lanes(road, lane)
