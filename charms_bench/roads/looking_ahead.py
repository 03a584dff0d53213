"""How fast a vehicle may be so that it can brake before slower lanes and where it has to stop."""

import math

from charms_bench.foundation.compiled import compiled
from charms_bench.roads.locating import coordinates_of
from charms_bench.roads.scenes import IDM, Here, lane_of, vehicle_of

BRAKING_MPS2 = 2.0
HORIZON_M = 150.0


@compiled
def look_ahead(here: Here) -> None:
    """Has IDM vehicles aim at speeds at which they can brake before slower lanes."""
    for i in range(here.places):
        vehicle = vehicle_of(here, i)
        if vehicle.kind == IDM and not vehicle.crashed and not vehicle.is_yielding:
            vehicle.target_speed = min(speed_ahead(here, i), vehicle.desired_speed)


@compiled
def speed_ahead(here: Here, i: int) -> float:
    """The highest speed from which vehicle i can brake before each lane ahead, m/s.

    At `BRAKING_MPS2`, to the limits of the lanes that begin within `HORIZON_M`, and to a standstill
    where it stops.
    """
    vehicle = vehicle_of(here, i)
    row, stops = lane_of(here, vehicle.lane), vehicle.stop_lane
    speed, number = float(row.speed_limit), vehicle.lane - row.first
    s = coordinates_of(here, i, vehicle.lane).s
    distance = row.length - s
    if stops >= 0 and lane_of(here, stops).first == row.first:
        return min(speed, math.sqrt(2 * BRAKING_MPS2 * max(vehicle.stop_s - s, 0.0)))
    for step in range(vehicle.route_step, vehicle.route_end):
        first, given = vehicle.route_roads[step], vehicle.route_numbers[step]
        if first == row.first:
            continue
        if distance > HORIZON_M:
            break
        following = lane_of(here, first)
        number = min(number if given < 0 else given, following.lanes - 1)
        ahead = lane_of(here, first + number)
        limit, way = ahead.speed_limit, max(distance, 0.0)
        speed = min(speed, math.sqrt(limit * limit + 2 * BRAKING_MPS2 * way))
        if stops >= 0 and lane_of(here, stops).first == first:
            way = max(distance + vehicle.stop_s, 0.0)
            return min(speed, math.sqrt(2 * BRAKING_MPS2 * way))
        distance += ahead.length
    return speed
