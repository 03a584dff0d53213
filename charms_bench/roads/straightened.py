"""Scenes on a network of lanes, straightened along the way of one of their vehicles, the viewer.

An agent of the straight road drives on a network through this view: x runs along the lanes that
the viewer follows, and y across the lanes of its road, of which lane 0 is the leftmost. A vehicle
is in the view while it is beside these lanes, or at most `END_MARGIN_M` before or after them, and
at most one lane from the viewer's road.
"""

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from charms_bench.engine.neighbours import find_neighbours, sort_by_x
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import Unpacked, compiled, inlined, wrap_to_pi
from charms_bench.roads.locating import coordinates_of, heading_on
from charms_bench.roads.looking_ahead import speed_ahead
from charms_bench.roads.scenes import NOTHING, Here, Row, Scenes, lane_of, vehicle_of
from charms_bench.world.lane_geometry import END_MARGIN_M
from charms_bench.world.road import local_coordinates, next_lane, position
from charms_bench.world.road_network import leads_to
from charms_bench.world.scene import VACANT_X_M, Scene

BEHIND, AHEAD = 3, 6
"""How many lanes of the way behind and ahead of the viewer's lane are in the view."""


@compiled
def _unpacked(ways: Any) -> Unpacked:
    """Unpacks ways; see `roads.scenes`."""
    return Unpacked(ways)  # type: ignore[no-untyped-call]


class _Fields(NamedTuple):
    """The fields of `Ways`."""

    lanes: Ints
    """[B, N, K] -1 for none."""
    numbers: Ints
    """[B, N, K] their numbers across the viewer's road."""
    starts: Floats
    """[B, N, K] x at their starts, m."""
    steps: Ints
    """[B, N] the steps of the viewers' routes from which the ways were found."""
    targets: Ints
    """[B, N] the numbers of the viewers' target lanes, as the view shows them."""
    open_lanes: Ints
    """[B, N] how many lanes of the viewer's road, from the left, may be driven on."""
    speed_limits: Floats
    """[B, N] those of the viewers' lanes, m/s."""


class Ways(_Fields):
    """The ways of vehicles, K = BEHIND + 1 + AHEAD lanes each; the lane `BEHIND` is its own."""

    @cached_property
    def unpacked(self) -> Unpacked:
        """The ways for compiled code, which unpacks them once."""
        return _unpacked(self)

    def __getstate__(self) -> None:
        """A copy of the ways is unpacked anew."""

    @classmethod
    def empty(cls, scenes: int, vehicles: int) -> "Ways":
        """The ways of B scenes that have not been started."""
        shape = (scenes, vehicles, BEHIND + 1 + AHEAD)
        lanes, numbers, starts = np.full(shape, -1), np.zeros(shape, np.int64), np.zeros(shape)
        steps, targets, open_lanes = np.zeros((3, *shape[:2]), np.int64)
        return cls(lanes, numbers, starts, steps, targets, open_lanes, np.zeros(shape[:2]))


@compiled
def straighten(
    scenes: Scenes, here: Here, ways: Ways, b: int, viewer: int, scene: Scene, v: int
) -> None:
    """Fills scene v of a straight road with scene b of a network, as a vehicle sees it.

    `here` is the state of scene b.
    """
    find_way(scenes, b, viewer, ways)
    lanes, numbers = ways.lanes[b, viewer], ways.numbers[b, viewer]
    own_road, width = lane_of(here, lanes[BEHIND]), scene.road.lane_width
    count = min(own_road.lanes, scene.road.lanes)
    for i in range(here.places):
        vehicle, best = vehicle_of(here, i), BEHIND
        if i != viewer:
            best = place_on(here, i, lanes, numbers, -1.5 * width, (count + 0.5) * width, width)
        if best < 0:
            scene.present[v, i] = False
            scene.x[v, i], scene.y[v, i] = VACANT_X_M - 1000.0 * i, 0.0
            scene.lane[v, i] = scene.target_lane[v, i] = 0
            scene.speed[v, i] = scene.heading[v, i] = 0.0
            scene.acceleration[v, i] = scene.target_speed[v, i] = 0.0
            scene.direction_x[v, i], scene.direction_y[v, i] = 1.0, 0.0
            scene.crashed[v, i] = vehicle.crashed
            continue
        scene.present[v, i] = True
        see(here, i, viewer, ways, b, best, scene, v)
    ways.targets[b, viewer] = scene.target_lane[v, viewer]
    ways.speed_limits[b, viewer] = own_road.speed_limit
    if here.constants.looks_ahead:  # in whole m/s, because each speed has views of its own
        ways.speed_limits[b, viewer] = max(math.floor(speed_ahead(here, viewer)), 1.0)
    open_lanes = numbers[BEHIND] + 1
    for number in range(numbers[BEHIND] + 1, count):
        if not lane_of(here, own_road.first + number).forbidden:
            open_lanes = number + 1
    ways.open_lanes[b, viewer] = open_lanes
    sort_by_x(scene, v, v + 1)
    find_neighbours(scene, v, v + 1)


@inlined
def see(
    here: Here, i: int, viewer: int, ways: Ways, b: int, best: int, scene: Scene, v: int
) -> None:
    """Fills in vehicle i of scene v, beside the lane `best` of the viewer's way."""
    lanes, numbers, starts = ways.lanes[b, viewer], ways.numbers[b, viewer], ways.starts[b, viewer]
    own_road, width = lane_of(here, lanes[BEHIND]), scene.road.lane_width
    count, vehicle = min(own_road.lanes, scene.road.lanes), vehicle_of(here, i)
    y = numbers[best] * width + coordinates_of(here, i, lanes[best]).r
    at = coordinates_of(here, i, lanes[best])
    scene.x[v, i], scene.y[v, i] = starts[best] + at.s, y
    heading = wrap_to_pi(vehicle.heading - heading_on(here, lane_of(here, lanes[best]), at.s))
    scene.heading[v, i] = heading
    scene.direction_y[v, i], scene.direction_x[v, i] = maths.sin_cos(heading)
    lane = numbers[BEHIND] if i == viewer else lane_at(y, width, count)
    scene.lane[v, i], scene.target_lane[v, i] = lane, target_beside(here, vehicle, lane, count)
    copy_state(scene, v, i, vehicle)


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
def place_on(
    here: Here, i: int, lanes: Ints, numbers: Ints, least_y: float, largest_y: float, width: float
) -> int:
    """The lane of a way (K,) that vehicle i is beside, as an index; -1 for none.

    The viewer's lane comes first, then those ahead, then those behind. A vehicle that is only just
    before or after some lanes is on the first of them.
    """
    found = -1
    if vehicle_of(here, i).kind == NOTHING:
        return found
    for m in range(lanes.size):
        k = BEHIND + m if BEHIND + m < lanes.size else lanes.size - 1 - m
        if lanes[k] < 0:
            continue
        at = coordinates_of(here, i, lanes[k])
        beyond = max(at.s - lane_of(here, lanes[k]).length, 0.0 - at.s, 0.0)
        y = numbers[k] * width + at.r
        if beyond <= END_MARGIN_M and least_y <= y <= largest_y:
            if beyond == 0.0:
                return k
            if found < 0:
                found = k
    return found


@inlined
def copy_state(scene: Scene, v: int, i: int, vehicle: Row) -> None:
    """Copies what does not depend on the view."""
    scene.speed[v, i], scene.crashed[v, i] = vehicle.speed, vehicle.crashed
    scene.acceleration[v, i], scene.steering[v, i] = vehicle.acceleration, vehicle.steering
    scene.length[v, i], scene.width[v, i] = vehicle.length, vehicle.width
    scene.target_speed[v, i], scene.timer_s[v, i] = vehicle.target_speed, vehicle.timer_s


@compiled
def find_way(scenes: Scenes, b: int, i: int, ways: Ways) -> None:
    """Finds the lanes ahead of vehicle i where it has changed its lane, its road or its route.

    Its x is continuous, and the lanes behind keep their places beside the vehicle.
    """
    road, vehicle = scenes.road, scenes.vehicles[b, i]
    lanes, numbers, starts = ways.lanes[b, i], ways.numbers[b, i], ways.starts[b, i]
    before, own = lanes[BEHIND], vehicle.lane
    if before == own and ways.steps[b, i] == vehicle.route_step:
        return
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
    ways.steps[b, i] = step = vehicle.route_step
    lanes[BEHIND + 1 :] = -1
    for k in range(BEHIND + 1, lanes.size):
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
