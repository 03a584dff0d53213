"""highway-env's observation `Kinematics` on its roads."""

import math

import numpy as np

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, wrap_to_pi
from charms_bench.foundation.generator import shuffle
from charms_bench.roads.scenes import NOTHING, OBSTACLE, Scenes
from charms_bench.world.kinematics_observation import FEATURES
from charms_bench.world.road import distance_along, heading_at, local_coordinates, position
from charms_bench.world.scene import Observations

PRESENCE, X, Y, VX, VY, HEADING, COS_H, SIN_H, COS_D, SIN_D, LONG_OFF, LAT_OFF, ANG_OFF = range(
    len(FEATURES)
)
PERCEPTION_M = 200.0
"""[`AbstractEnv.PERCEPTION_DISTANCE`]"""


@compiled_of_scenes
def observe(
    scenes: Scenes,
    rows: Ints,
    ego_place: int,
    features: Ints,
    ranges: Floats,
    how: Ints,
    out: Observations,
) -> None:
    """Writes the observations (B, rows, F) of an ego in the scenes `rows` [`KinematicObservation`].

    `features` (F,) are indices into `FEATURES`, and `ranges` (B, F, 2) what is mapped onto [-1, 1];
    not a number where nothing is. `how` says whether positions are absolute, vehicles are sorted,
    values clipped, vehicles behind seen, obstacles included, other vehicles' destinations seen, and
    the rows after the ego's shuffled by the scene's generator; then the lane along which the ego's
    x is measured, -1 for the x of the road [`ExitObservation`].
    """
    is_absolute, is_sorted, clips, sees_behind = how[:4]
    has_obstacles, sees_intentions, shuffles, exit_lane = how[4:]
    places, has_more = scenes.vehicles.shape[1], features.max() >= COS_D
    near, away = np.empty(places, dtype=np.int64), np.empty(places)
    values = np.empty(len(FEATURES))
    for b in rows:
        ego = scenes.vehicles[b, ego_place]
        count = 0
        for m in range(places):
            j = scenes.order[b, m].place
            other = scenes.vehicles[b, j]
            is_obstacle = other.kind <= OBSTACLE
            if j == ego_place or other.kind == NOTHING or (is_obstacle and not has_obstacles):
                continue
            dx, dy = other.x - ego.x, other.y - ego.y
            if not math.sqrt(dx * dx + dy * dy) < PERCEPTION_M:
                continue
            ahead = distance_along(scenes.road, ego.lane, ego.x, ego.y, other.x, other.y)
            if not (-2 * ego.length < ahead or (sees_behind and not is_obstacle)):
                continue
            k = count
            while is_sorted and k > 0 and away[k - 1] > abs(ahead):
                near[k], away[k] = near[k - 1], away[k - 1]
                k -= 1
            near[k], away[k] = j, abs(ahead)
            count += 1
        for row in range(out.shape[1]):
            if row > count:
                out[b, row] = 0.0
                continue
            j = near[row - 1] if row else ego_place
            origin = ego_place if row > 0 and not is_absolute else -1
            describe(scenes, b, j, origin, values)
            if has_more:
                describe_way(scenes, b, j, row == 0 or sees_intentions, values)
            if row == 0 and exit_lane >= 0:
                values[X], _ = local_coordinates(scenes.road, exit_lane, ego.x, ego.y)
            for f in range(features.size):
                value, low, high = values[features[f]], ranges[b, f, 0], ranges[b, f, 1]
                if not math.isnan(low):
                    value = -1 + (value - low) * 2 / (high - low)
                    if clips and not math.isnan(value):
                        value = min(max(value, -1.0), 1.0)
                out[b, row, f] = value
        if shuffles:
            shuffle(scenes.generator[b], out[b, 1:])


@compiled
def describe(scenes: Scenes, b: int, j: int, origin: int, values: Floats) -> None:
    """Fills in the `FEATURES` of a vehicle or an obstacle [`Vehicle.to_dict`].

    Positions and velocities are those relative to the vehicle at the place `origin`, if any.
    """
    vehicle = scenes.vehicles[b, j]
    values[PRESENCE] = 1.0
    # highway-env does not say an obstacle's heading [`RoadObject.to_dict`].
    values[HEADING] = math.nan if vehicle.kind <= OBSTACLE else vehicle.heading
    values[X], values[Y] = vehicle.x, vehicle.y
    values[VX] = vehicle.speed * vehicle.direction_x
    values[VY] = vehicle.speed * vehicle.direction_y
    values[COS_H], values[SIN_H] = vehicle.direction_x, vehicle.direction_y
    if origin >= 0:
        ego = scenes.vehicles[b, origin]
        values[X] -= ego.x
        values[Y] -= ego.y
        values[VX] -= ego.speed * ego.direction_x
        values[VY] -= ego.speed * ego.direction_y


@compiled
def describe_way(scenes: Scenes, b: int, j: int, shows_destination: bool, values: Floats) -> None:
    """Fills in the `FEATURES` of a vehicle or an obstacle that depend on its route and its lane.

    [`destination_direction`, `lane_offset`]
    """
    vehicle, road = scenes.vehicles[b, j], scenes.road
    values[COS_D] = values[SIN_D] = 0.0
    if vehicle.kind <= OBSTACLE:  # highway-env does not say its lane [`RoadObject.to_dict`]
        values[LONG_OFF] = values[LAT_OFF] = values[ANG_OFF] = math.nan
        return
    if shows_destination and vehicle.route_step < vehicle.route_end:
        last = vehicle.route_end - 1
        lane = vehicle.route_roads[last] + max(vehicle.route_numbers[last], 0)
        x, y = position(road, lane, road.lanes[lane].length, 0.0)
        dx, dy = x - vehicle.x, y - vehicle.y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance > 0:
            values[COS_D], values[SIN_D] = dx / distance, dy / distance
    values[LONG_OFF], values[LAT_OFF] = local_coordinates(road, vehicle.lane, vehicle.x, vehicle.y)
    heading = heading_at(road, vehicle.lane, values[LONG_OFF])
    values[ANG_OFF] = wrap_to_pi(vehicle.heading - heading)
