"""Scenes on a network of lanes, straightened along the way of the ego.

An agent of the straight road drives on a network through this view: x runs along the lanes that
the ego follows, and y across the lanes of its road, of which lane 0 is the leftmost. A vehicle is
in the view while it is beside these lanes, or at most `END_MARGIN_M` before or after them, and at
most one lane from the ego's road.
"""

from typing import NamedTuple

import numpy as np

from charms_bench.engine.neighbours import find_neighbours, sort_by_x
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, wrap_to_pi
from charms_bench.roads.locating import coordinates_of
from charms_bench.roads.scenes import NOTHING, Here, Row, Scenes, lane_of, vehicle_of
from charms_bench.world.lane_geometry import END_MARGIN_M, line_heading
from charms_bench.world.road import local_coordinates, next_lane, position
from charms_bench.world.scene import VACANT_X_M, Scene

BEHIND, AHEAD = 3, 6
"""How many lanes of the way behind and ahead of the ego's lane are in the view."""


class Ways(NamedTuple):
    """The ways of the egos, K = BEHIND + 1 + AHEAD lanes each; the lane `BEHIND` is the ego's."""

    lanes: Ints
    """[B, K] -1 for none."""
    numbers: Ints
    """[B, K] their numbers across the ego's road."""
    starts: Floats
    """[B, K] x at their starts, m."""
    steps: Ints
    """[B] the steps of the egos' routes from which the ways were found."""
    targets: Ints
    """[B] the numbers of the egos' target lanes, as the view shows them."""
    open_lanes: Ints
    """[B] how many lanes of the ego's road, from the left, may be driven on."""
    speed_limits: Floats
    """[B] those of the egos' lanes, m/s."""

    @classmethod
    def empty(cls, scenes: int) -> "Ways":
        """The ways of B scenes that have not been started."""
        shape = (scenes, BEHIND + 1 + AHEAD)
        lanes, numbers, starts = np.full(shape, -1), np.zeros(shape, np.int64), np.zeros(shape)
        steps, targets, open_lanes = np.zeros((3, scenes), np.int64)
        return cls(lanes, numbers, starts, steps, targets, open_lanes, np.zeros(scenes))


@compiled
def straighten(scenes: Scenes, here: Here, scene: Scene, ways: Ways, b: int) -> None:
    """Fills scene b of a straight road from scene b of a network, whose state is `here`."""
    find_way(scenes, b, ways)
    lanes, numbers, starts = ways.lanes[b], ways.numbers[b], ways.starts[b]
    own_road, width = lane_of(here, lanes[BEHIND]), scene.road.lane_width
    count = min(own_road.lanes, scene.road.lanes)
    for i in range(here.places):
        vehicle, best = vehicle_of(here, i), BEHIND
        if i > 0:
            best = place_on(here, i, ways, b, -1.5 * width, (count + 0.5) * width, width)
        if best < 0:
            scene.present[b, i] = False
            scene.x[b, i], scene.y[b, i] = VACANT_X_M - 1000.0 * i, 0.0
            scene.lane[b, i] = scene.target_lane[b, i] = 0
            scene.speed[b, i] = scene.heading[b, i] = 0.0
            scene.direction_x[b, i], scene.direction_y[b, i] = 1.0, 0.0
            scene.crashed[b, i] = vehicle.crashed
            continue
        y = numbers[best] * width + coordinates_of(here, i, lanes[best]).r
        at = coordinates_of(here, i, lanes[best])
        scene.present[b, i] = True
        scene.x[b, i], scene.y[b, i] = starts[best] + at.s, y
        heading = wrap_to_pi(vehicle.heading - line_heading(lane_of(here, lanes[best]), at.s))
        scene.heading[b, i] = heading
        scene.direction_y[b, i], scene.direction_x[b, i] = maths.sin_cos(heading)
        lane = min(max(round(y / width), 0), count - 1) if i > 0 else numbers[BEHIND]
        scene.lane[b, i] = scene.target_lane[b, i] = lane
        if lane_of(here, vehicle.target_lane).first == lane_of(here, vehicle.lane).first:
            target = lane + vehicle.target_lane - vehicle.lane
            scene.target_lane[b, i] = min(max(target, 0), count - 1)
        copy_state(scene, b, i, vehicle)
    ways.targets[b] = scene.target_lane[b, 0]
    ways.speed_limits[b] = own_road.speed_limit
    ways.open_lanes[b] = numbers[BEHIND] + 1
    for number in range(numbers[BEHIND] + 1, count):
        if not lane_of(here, own_road.first + number).forbidden:
            ways.open_lanes[b] = number + 1
    sort_by_x(scene, b, b + 1)
    find_neighbours(scene, b, b + 1)


@compiled
def place_on(
    here: Here, i: int, ways: Ways, b: int, least_y: float, largest_y: float, width: float
) -> int:
    """The lane of a way that vehicle i is beside, as an index; -1 for none.

    The ego's lane comes first, then those ahead, then those behind. A vehicle that is only just
    before or after some lanes is on the first of them.
    """
    lanes, found = ways.lanes[b], -1
    if vehicle_of(here, i).kind == NOTHING:
        return found
    for m in range(lanes.size):
        k = BEHIND + m if BEHIND + m < lanes.size else lanes.size - 1 - m
        if lanes[k] < 0:
            continue
        at = coordinates_of(here, i, lanes[k])
        beyond = max(at.s - lane_of(here, lanes[k]).length, 0.0 - at.s, 0.0)
        y = ways.numbers[b, k] * width + at.r
        if beyond <= END_MARGIN_M and least_y <= y <= largest_y:
            if beyond == 0.0:
                return k
            if found < 0:
                found = k
    return found


@compiled
def copy_state(scene: Scene, b: int, i: int, vehicle: Row) -> None:
    """Copies what does not depend on the view; the ego's target speed is the scene's own."""
    scene.speed[b, i], scene.crashed[b, i] = vehicle.speed, vehicle.crashed
    scene.acceleration[b, i], scene.steering[b, i] = vehicle.acceleration, vehicle.steering
    scene.length[b, i], scene.width[b, i] = vehicle.length, vehicle.width
    if i > 0:
        scene.target_speed[b, i], scene.timer_s[b, i] = vehicle.target_speed, vehicle.timer_s


@compiled
def find_way(scenes: Scenes, b: int, ways: Ways) -> None:
    """Finds the lanes ahead of the ego where it has changed its lane, its road or its route.

    Its x is continuous, and the lanes behind keep their places beside the ego.
    """
    road, ego = scenes.road, scenes.vehicles[b, 0]
    lanes, numbers, starts = ways.lanes[b], ways.numbers[b], ways.starts[b]
    before, own = lanes[BEHIND], ego.lane
    if before == own and ways.steps[b] == ego.route_step:
        return
    number = own - road.lanes[own].first
    if before < 0:
        start = 0.0
        lanes[:BEHIND] = -1
    elif before == own:
        start = starts[BEHIND]
    else:
        # A half circle does not say how far beyond its end the ego is; the lane after it does.
        k = BEHIND
        if lanes[k + 1] >= 0 and road.lanes[lanes[k + 1]].first == road.lanes[own].first:
            k += road.lanes[before].first != road.lanes[own].first
        along, _ = local_coordinates(road, lanes[k], ego.x, ego.y)
        s, _ = local_coordinates(road, own, ego.x, ego.y)
        start = starts[k] + along - s
        if road.lanes[before].first != road.lanes[own].first:
            numbers[: BEHIND + 1] += number - numbers[BEHIND]
            for k in range(BEHIND):
                lanes[k], numbers[k], starts[k] = lanes[k + 1], numbers[k + 1], starts[k + 1]
    lanes[BEHIND], numbers[BEHIND], starts[BEHIND] = own, number, start
    ways.steps[b] = step = ego.route_step
    lanes[BEHIND + 1 :] = -1
    for k in range(BEHIND + 1, lanes.size):
        lane = lanes[k - 1]
        row = road.lanes[lane]
        next_road = next_number = -1
        if step < ego.route_end:
            step += ego.route_roads[step] == row.first
        if step < ego.route_end:
            for following in road.successors[row.next_roads : row.next_roads + row.next_count]:
                if following == ego.route_roads[step]:
                    next_road, next_number = following, ego.route_numbers[step]
        x, y = position(road, lane, row.length, 0.0)
        found = next_lane(road, lane, next_road, next_number, x, y)
        if found == lane:
            break
        lanes[k], numbers[k], starts[k] = found, number, starts[k - 1] + row.length
