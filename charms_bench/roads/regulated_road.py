"""Who has the right of way where roads cross, operation for operation as in highway-env.

Vehicles are predicted to keep their speeds and to follow their routes. Where two of them would
meet, one has to stop [`RegulatedRoad`].
"""

import math

import numpy as np

from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.compiled import compiled
from charms_bench.roads.dynamics import move
from charms_bench.roads.locating import coordinates_of
from charms_bench.roads.scenes import (
    CONTINUOUS,
    IDM,
    OBSTACLE,
    Here,
    Row,
    lane_of,
    place_of,
    vehicle_of,
)
from charms_bench.world.road import heading_at, position
from charms_bench.world.road_network import Network

FREQUENCY_HZ = 2
"""How often the rules are enforced [`REGULATION_FREQUENCY`]."""
STEP_S, TIMES = 0.25, 11
"""Vehicles are predicted after so many times as many seconds [`is_conflict_possible`]."""
LONGER, NARROWER = 1.5, 0.9
"""The factors by which rectangles differ from vehicles."""
_CORNERS = ((-1, -1), (-1, 1), (1, 1), (1, -1), (0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
"""The points of a rectangle that are looked for in another one, in half lengths and widths."""


@compiled
def enforce(road: Network, here: Here) -> None:
    """Has vehicles start and stop by the rules [`RegulatedRoad.enforce_road_rules`]."""
    predicted = np.empty((here.places, TIMES, 3))
    count = 0
    for k in range(here.places):
        i = place_of(here, k)
        vehicle = vehicle_of(here, i)
        if vehicle.kind <= OBSTACLE:
            break  # the vehicles come first
        count += 1
        if vehicle.is_yielding:
            vehicle.is_yielding = False
            limit = lane_of(here, vehicle.lane).speed_limit
            vehicle.target_speed = min(limit, vehicle.desired_speed)
        predict(road, here, i, predicted[k])
    for k in range(count):
        for m in range(k + 1, count):
            one, other = vehicle_of(here, place_of(here, k)), vehicle_of(here, place_of(here, m))
            for t in range(TIMES):
                if meet(one, other, predicted[k, t], predicted[m, t]):
                    resolve(here, one, other)
                    break


@compiled
def predict(road: Network, here: Here, i: int, predicted: Floats) -> None:
    """Predicts positions and headings (TIMES, 3) [`predict_trajectory_constant_speed`]."""
    vehicle = vehicle_of(here, i)
    if vehicle.kind <= CONTINUOUS:
        coast(vehicle, predicted)
        return
    for t in range(TIMES):
        lane, s = along_route(here, i, (t + 1) * STEP_S)
        x, y = position(road, lane, s, 0.0)
        predicted[t, 0], predicted[t, 1], predicted[t, 2] = x, y, heading_at(road, lane, s)


@compiled
def coast(vehicle: Row, predicted: Floats) -> None:
    """Predicts a vehicle that keeps its steering angle [`Vehicle`]."""
    place = vehicle.x, vehicle.y, vehicle.heading, vehicle.direction_x, vehicle.direction_y
    motion = vehicle.speed, vehicle.acceleration, vehicle.steering
    slip = vehicle.lateral_speed, vehicle.yaw_rate
    state = vehicle.crashed, vehicle.has_impact
    vehicle.acceleration = 0.0
    for t in range(TIMES):
        move(vehicle, STEP_S)
        predicted[t, 0], predicted[t, 1], predicted[t, 2] = vehicle.x, vehicle.y, vehicle.heading
    vehicle.x, vehicle.y, vehicle.heading, vehicle.direction_x, vehicle.direction_y = place
    vehicle.speed, vehicle.acceleration, vehicle.steering = motion
    vehicle.lateral_speed, vehicle.yaw_rate = slip
    vehicle.crashed, vehicle.has_impact = state


@compiled
def along_route(here: Here, i: int, time: float) -> tuple[int, float]:
    """The lane on which a vehicle is predicted after a time, s, and how far along it.

    [`RoadNetwork.position_heading_along_route`]
    """
    vehicle = vehicle_of(here, i)
    number = vehicle.lane - lane_of(here, vehicle.lane).first
    s = coordinates_of(here, i, vehicle.lane).s + vehicle.speed * time
    step, lane = vehicle.route_step, vehicle.lane
    while step < vehicle.route_end:
        given = vehicle.route_numbers[step]
        lane = vehicle.route_roads[step] + (number if given < 0 else given)
        step += 1
        if step == vehicle.route_end or not s > lane_of(here, lane).length:
            break
        s -= lane_of(here, lane).length
    return lane, s


@compiled
def meet(one: Row, other: Row, here: Floats, there: Floats) -> bool:
    """Whether vehicles touch that are at two predicted positions with headings (3,)."""
    dx, dy = there[0] - here[0], there[1] - here[1]
    if math.sqrt(dx * dx + dy * dy) > max(one.length, other.length):
        return False
    return has_point_inside(one, other, here, there) or has_point_inside(other, one, there, here)


@compiled
def has_point_inside(one: Row, other: Row, here: Floats, there: Floats) -> bool:
    """Whether a corner, a middle of a side or the centre of one vehicle is within the other.

    As in highway-env, the latter is turned in the wrong direction [`utils.has_corner_inside`,
    `utils.point_in_rotated_rectangle`].
    """
    half_length, half_width = LONGER * one.length / 2, NARROWER * one.width / 2
    sine, cosine = maths.sin_cos(here[2])
    other_sine, other_cosine = maths.sin_cos(there[2])
    for ahead, aside in _CORNERS:
        x, y = ahead * half_length, aside * half_width
        dx = cosine * x - sine * y + here[0] - there[0]
        dy = sine * x + cosine * y + here[1] - there[1]
        along = other_cosine * dx - other_sine * dy
        across = other_sine * dx + other_cosine * dy
        if abs(along) <= LONGER * other.length / 2 and abs(across) <= NARROWER * other.width / 2:
            return True
    return False


@compiled
def resolve(here: Here, one: Row, other: Row) -> None:
    """Has one of two vehicles stop [`RegulatedRoad.respect_priorities`]."""
    priority = lane_of(here, one.lane).priority
    other_priority = lane_of(here, other.lane).priority
    dx, dy = other.x - one.x, other.y - one.y
    ahead = one.direction_x * dx + one.direction_y * dy
    other_ahead = other.direction_x * -dx + other.direction_y * -dy
    is_first = priority < other_priority
    if priority == other_priority:
        is_first = ahead > other_ahead
    if is_first:
        yield_to(one)
    else:
        yield_to(other)


@compiled
def yield_to(vehicle: Row) -> None:
    """Has a vehicle stop if it is an IDM vehicle [`RegulatedRoad.enforce_road_rules`]."""
    if vehicle.kind == IDM:
        vehicle.target_speed = 0.0
        vehicle.is_yielding = True
