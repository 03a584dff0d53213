"""Scenes on a network of lanes, straightened along the way of one of their vehicles, the viewer.

An agent of the straight road drives on a network through this view: x runs along the lanes that
the viewer follows, and y across the lanes of its road, of which lane 0 is the leftmost. A vehicle
is in the view while it is beside these lanes, or at most `END_MARGIN_M` before or after them, and
at most one lane from the viewer's road.
"""

import math

from charms_bench.engine.neighbours import find_neighbours, sort_by_x
from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled, inlined, wrap_to_pi
from charms_bench.roads.locating import coordinates_of, heading_on
from charms_bench.roads.looking_ahead import speed_ahead
from charms_bench.roads.scenes import (
    BEHIND,
    NOTHING,
    WAY_LANES,
    Here,
    Row,
    lane_of,
    vehicle_of,
    way_of,
)
from charms_bench.world.lane_geometry import END_MARGIN_M
from charms_bench.world.road import local_coordinates, next_lane, position
from charms_bench.world.road_network import Network, leads_to
from charms_bench.world.scene import VACANT_X_M, Scene


@compiled
def straighten(road: Network, here: Here, viewer: int, scene: Scene, v: int) -> None:
    """Fills scene v of a straight road with a scene of a network, as a vehicle sees it."""
    if has_left_way(here, viewer):
        find_way(road, here, viewer)
    scene.present[v, viewer] = True
    see(here, viewer, 0, here.places, scene, v)
    way = way_of(here, viewer)
    own_road = lane_of(here, way.lanes[BEHIND])
    way.target = scene.target_lane[v, viewer]
    way.speed_limit = own_road.speed_limit
    if here.constants.looks_ahead:  # in whole m/s, because each speed has views of its own
        way.speed_limit = max(math.floor(speed_ahead(here, viewer)), 1.0)
    number = way.numbers[BEHIND]
    way.open_lanes = number + 1
    for each in range(number + 1, min(own_road.lanes, scene.road.lanes)):
        if not lane_of(here, own_road.first + each).forbidden:
            way.open_lanes = each + 1
    sort_by_x(scene, v, v + 1)
    find_neighbours(scene, v, v + 1)


@compiled
def see(here: Here, viewer: int, first: int, after: int, scene: Scene, v: int) -> None:
    """Fills in the vehicles from `first` on, and before `after`, of scene v."""
    way, road_width = way_of(here, viewer), scene.road.lane_width
    count = min(lane_of(here, way.lanes[BEHIND]).lanes, scene.road.lanes)
    # Named once, because compiled code looks up an array whenever it is named.
    present, crashed, x, y = scene.present[v], scene.crashed[v], scene.x[v], scene.y[v]
    heading, speed, acceleration = scene.heading[v], scene.speed[v], scene.acceleration[v]
    direction_x, direction_y = scene.direction_x[v], scene.direction_y[v]
    lane, target_lane, steering = scene.lane[v], scene.target_lane[v], scene.steering[v]
    length, width, timer_s = scene.length[v], scene.width[v], scene.timer_s[v]
    target_speed = scene.target_speed[v]
    for i in range(first, after):
        k, vehicle = BEHIND, vehicle_of(here, i)
        if i != viewer:
            low, high = -1.5 * road_width, (count + 0.5) * road_width
            k = place_on(here, i, way, low, high, road_width)
            present[i] = k >= 0
        crashed[i] = vehicle.crashed
        if k < 0:
            x[i], y[i] = VACANT_X_M - 1000.0 * i, 0.0
            lane[i] = target_lane[i] = 0
            speed[i] = heading[i] = acceleration[i] = target_speed[i] = 0.0
            direction_x[i], direction_y[i] = 1.0, 0.0
            continue
        at = coordinates_of(here, i, way.lanes[k])
        x[i], y[i] = way.starts[k] + at.s, way.numbers[k] * road_width + at.r
        of_lane = heading_on(here, lane_of(here, way.lanes[k]), at.s)
        heading[i] = wrap_to_pi(vehicle.heading - of_lane)
        direction_y[i], direction_x[i] = maths.sin_cos(heading[i])
        lane[i] = way.numbers[BEHIND] if i == viewer else lane_at(y[i], road_width, count)
        target_lane[i] = target_beside(here, vehicle, lane[i], count)
        speed[i], acceleration[i] = vehicle.speed, vehicle.acceleration
        steering[i], timer_s[i] = vehicle.steering, vehicle.timer_s
        length[i], width[i] = vehicle.length, vehicle.width
        target_speed[i] = vehicle.target_speed


@inlined
def lane_at(y: float, width: float, count: int) -> int:
    """The lane of a vehicle in a view, of a road with so many lanes."""
    return int(min(max(round(y / width), 0), count - 1))


@inlined
def target_beside(here: Here, vehicle: Row, lane: int, count: int) -> int:
    """The target lane of a vehicle in a view that shows it on a lane."""
    if lane_of(here, vehicle.target_lane).first != lane_of(here, vehicle.lane).first:
        return lane
    return int(min(max(lane + vehicle.target_lane - vehicle.lane, 0), count - 1))


@compiled
def place_on(here: Here, i: int, way: Row, least_y: float, largest_y: float, width: float) -> int:
    """The lane of a way that vehicle i is beside, as an index; -1 for none.

    The viewer's lane comes first, then those ahead, then those behind. A vehicle that is only just
    before or after some lanes is on the first of them.
    """
    found = -1
    if vehicle_of(here, i).kind == NOTHING:
        return found
    for m in range(WAY_LANES):
        k = BEHIND + m if BEHIND + m < WAY_LANES else WAY_LANES - 1 - m
        if way.lanes[k] < 0:
            continue
        at = coordinates_of(here, i, way.lanes[k])
        beyond = max(at.s - lane_of(here, way.lanes[k]).length, 0.0 - at.s, 0.0)
        y = way.numbers[k] * width + at.r
        if beyond <= END_MARGIN_M and least_y <= y <= largest_y:
            if beyond == 0.0:
                return k
            if found < 0:
                found = k
    return found


@inlined
def has_left_way(here: Here, i: int) -> bool:
    """Whether the way of vehicle i has to be found, for the first time or again."""
    way, vehicle = way_of(here, i), vehicle_of(here, i)
    return bool(way.lanes[BEHIND] != vehicle.lane or way.step != vehicle.route_step)


@compiled
def find_way(road: Network, here: Here, i: int) -> None:
    """Finds the lanes ahead of vehicle i, which has changed its lane, its road or its route.

    Its x is continuous, and the lanes behind keep their places beside the vehicle.
    """
    vehicle, way = vehicle_of(here, i), way_of(here, i)
    lanes, numbers, starts = way.lanes, way.numbers, way.starts
    before, own = lanes[BEHIND], vehicle.lane
    number = own - road.lanes[own].first
    if before < 0:
        start = 0.0
        lanes[:BEHIND] = -1
    elif before == own:
        start = starts[BEHIND]
    else:
        # A half circle does not say how far beyond its end the vehicle is; the lane after it does.
        k = BEHIND
        if lanes[k + 1] >= 0 and road.lanes[lanes[k + 1]].first == road.lanes[own].first:
            k += road.lanes[before].first != road.lanes[own].first
        along, _ = local_coordinates(road, lanes[k], vehicle.x, vehicle.y)
        s, _ = local_coordinates(road, own, vehicle.x, vehicle.y)
        start = starts[k] + along - s
        if road.lanes[before].first != road.lanes[own].first:
            numbers[: BEHIND + 1] += number - numbers[BEHIND]
            for k in range(BEHIND):
                lanes[k], numbers[k], starts[k] = lanes[k + 1], numbers[k + 1], starts[k + 1]
    lanes[BEHIND], numbers[BEHIND], starts[BEHIND] = own, number, start
    way.step = step = vehicle.route_step
    lanes[BEHIND + 1 :] = -1
    for k in range(BEHIND + 1, WAY_LANES):
        lane = lanes[k - 1]
        row = road.lanes[lane]
        next_road = next_number = -1
        if step < vehicle.route_end:
            step += vehicle.route_roads[step] == row.first
        if step < vehicle.route_end and leads_to(road, lane, vehicle.route_roads[step]):
            next_road, next_number = vehicle.route_roads[step], vehicle.route_numbers[step]
        x, y = position(road, lane, row.length, 0.0)
        found = next_lane(road, lane, next_road, next_number, x, y)
        if found == lane:
            break
        lanes[k], numbers[k], starts[k] = found, number, starts[k - 1] + row.length
