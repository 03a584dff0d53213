"""How vehicles move: steering, the bicycle model and its limits, step by step [`Vehicle.step`].

Motion is computed in loops over the vehicles of a block of scenes that call one elementary function
each, because such loops vectorise.
"""

from typing import NamedTuple

import numpy as np

from charms_bench.engine.neighbours import search_neighbours
from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, compiled, index, not_zero, wrap_to_pi
from charms_bench.world.bicycle import (
    displacement,
    limited,
    slip_of,
    slip_to_turn,
    steering_of,
    towards_centre,
    towards_speed,
    turn_of,
)
from charms_bench.world.profile import Constants
from charms_bench.world.road import (
    closest_lane,
    distance_with_heading,
    local_coordinates,
    side_lanes,
)
from charms_bench.world.scene import Bools, Floats, Ints, Scene


class Turning(NamedTuple):
    """The vehicles of a block that turn, packed; each block uses the arrays (M,) again."""

    vehicle: Ints
    """The vehicle's index among all vehicles of the block."""
    is_steered: Bools
    """Whether the vehicle controls its steering; not if it has crashed or has a zero-order hold."""
    x: Floats
    """Position before the step, m."""
    lateral: Floats
    """Position beside the centre of the target lane, m."""
    heading: Floats
    speed: Floats
    half_length: Floats
    angle: Floats
    """Intermediate results, rad."""
    steering: Floats
    ahead: Floats
    """Displacement along the road, m."""
    aside: Floats
    direction_x: Floats
    direction_y: Floats


@compiled
def room_to_turn(vehicles: int) -> Turning:
    """Arrays for a block of so many vehicles."""
    marks = np.empty(vehicles, np.int64), np.empty(vehicles, np.bool_)
    f = np.empty((11, vehicles))
    return Turning(*marks, *(f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9], f[10]))


@compiled
def steer(turning: Turning, count: int, c: Constants) -> None:
    """Computes the steering angles of `count` vehicles towards the centres of their target lanes.

    Vehicles that are not steered keep the angle that they have.

    [`ControlledVehicle.steering_control`]
    """
    lateral, heading, speed = turning.lateral, turning.heading, turning.speed
    half_length = turning.half_length
    angle, steering, is_steered = turning.angle, turning.steering, turning.is_steered
    for k in range(count):
        angle[k] = towards_centre(lateral[k], not_zero(speed[k]), c.tau_lateral) - heading[k]
    for k in range(count):
        angle[k] = wrap_to_pi(angle[k])
    for k in range(count):
        angle[k] = slip_to_turn(angle[k], not_zero(speed[k]), half_length[k], c.tau_heading)
    for k in range(count):
        angle[k] = maths.tan(angle[k])
    for k in range(count):
        wanted = clip(steering_of(angle[k]), -c.steering_limit, c.steering_limit)
        steering[k] = wanted if is_steered[k] else steering[k]


@compiled
def turn(turning: Turning, count: int, c: Constants) -> None:
    """Computes the displacements and new headings of `count` vehicles [`Vehicle.step`]."""
    heading, speed, angle = turning.heading, turning.speed, turning.angle
    half_length = turning.half_length
    steering, ahead, aside = turning.steering, turning.ahead, turning.aside
    direction_x, direction_y = turning.direction_x, turning.direction_y
    for k in range(count):
        angle[k] = maths.tan(steering[k])
    for k in range(count):
        angle[k] = slip_of(angle[k])
    for k in range(count):
        ahead[k], aside[k] = displacement(heading[k], angle[k], speed[k], c.dt)
    for k in range(count):
        heading[k] += turn_of(angle[k], speed[k], half_length[k], c.dt)
    for k in range(count):
        direction_y[k], direction_x[k] = maths.sin_cos(heading[k])


@compiled
def move(
    scene: Scene,
    first: int,
    after: int,
    modelled: Bools,
    zero_order_hold: Bools,
    turning: Turning,
) -> None:
    """Steers and moves the scenes from `first` to before `after` by one step of the bicycle model.

    `modelled` [B, N] marks the vehicles whose acceleration a driver model has set;
    `zero_order_hold` marks those that keep their acceleration and steering; all others control
    their target speed [`ControlledVehicle.act`, `Vehicle.clip_actions`, `Vehicle.step`].
    """
    c, road = scene.constants, scene.road
    x, y = scene.x[first:after].reshape(-1), scene.y[first:after].reshape(-1)
    heading, speed = scene.heading[first:after].reshape(-1), scene.speed[first:after].reshape(-1)
    length = scene.length[first:after].reshape(-1)
    acceleration = scene.acceleration[first:after].reshape(-1)
    steering = scene.steering[first:after].reshape(-1)
    target_speed = scene.target_speed[first:after].reshape(-1)
    target_lane = scene.target_lane[first:after].reshape(-1)
    timer_s, lane = scene.timer_s[first:after].reshape(-1), scene.lane[first:after].reshape(-1)
    crashed, impact = scene.crashed[first:after].reshape(-1), scene.impact[first:after].reshape(-1)
    is_modelled = modelled[first:after].reshape(-1)
    has_hold = zero_order_hold[first:after].reshape(-1)
    turns = 0
    for i in range(x.size):
        turning.vehicle[turns] = i
        # The functions of a vehicle that goes straight would give 0 and 1.
        _, lateral = local_coordinates(road, target_lane[i], x[i], y[i])
        is_beside = (lateral != 0.0) & (not crashed[i])
        turns += (heading[i] != 0.0) | is_beside | (has_hold[i] & (steering[i] != 0.0))
    for k in range(turns):
        i = index(turning.vehicle[k])
        turning.is_steered[k] = not (crashed[i] or has_hold[i])
        turning.steering[k] = steering[i] if has_hold[i] and not crashed[i] else 0.0
        turning.x[k] = x[i]
        _, turning.lateral[k] = local_coordinates(road, target_lane[i], x[i], y[i])
        turning.heading[k] = heading[i]
        turning.speed[k] = speed[i]
        turning.half_length[k] = length[i] / 2
    # Each loop has few arrays: LLVM does not vectorise a loop over many that might overlap.
    for i in range(x.size):
        v = speed[i]
        wanted = towards_speed(v, target_speed[i], c.tau_acceleration)
        wanted = acceleration[i] if is_modelled[i] | has_hold[i] else wanted
        wanted = -1.0 * v if crashed[i] else wanted
        acceleration[i] = limited(wanted, v, c.speed_min, c.speed_max)
    for i in range(x.size):
        timer_s[i] += c.dt
    for i in range(x.size):
        x[i] += speed[i] * c.dt
    for i in range(x.size):
        speed[i] += acceleration[i] * c.dt
    for i in range(0 if c.can_reverse else x.size):
        if speed[i] < 0.0:
            acceleration[i] -= speed[i] / c.dt
            speed[i] = 0.0
    for i in range(x.size):
        steering[i] = 0.0
    steer(turning, turns, c)
    turn(turning, turns, c)
    direction_x = scene.direction_x[first:after].reshape(-1)
    direction_y = scene.direction_y[first:after].reshape(-1)
    for k in range(turns):
        i = index(turning.vehicle[k])
        x[i] = turning.x[k] + turning.ahead[k]
        y[i] += turning.aside[k]
        heading[i] = turning.heading[k]
        direction_x[i], direction_y[i] = turning.direction_x[k], turning.direction_y[k]
        steering[i] = turning.steering[k]
        lane[i] = closest_lane(road, x[i], y[i], heading[i])
    for i in range(x.size):
        if impact[i]:
            x[i] += scene.impact_x[first + i // scene.x.shape[1], i % scene.x.shape[1]]
            y[i] += scene.impact_y[first + i // scene.x.shape[1], i % scene.x.shape[1]]
            crashed[i] = True
            impact[i] = False
            lane[i] = closest_lane(road, x[i], y[i], heading[i])


@compiled
def follow_no_lane(scene: Scene, marked: Bools) -> None:
    """Makes the nearest lanes of the marked vehicles [B, N] their target lanes too.

    The vehicles are in order.

    Near a border, `closest_lane` is corrected: highway-env rounds the distances of the lanes with
    what they have in common, the distance beyond the road's ends and the heading, so they can be
    equal [`AbstractLane.distance_with_heading`].
    """
    road = scene.road
    for b in range(marked.shape[0]):
        for i in range(marked.shape[1]):
            if not marked[b, i]:
                continue
            x, y, heading = scene.x[b, i], scene.y[b, i], scene.heading[b, i]
            lane = closest_lane(road, x, y, heading)
            left, _ = side_lanes(road, lane)
            if left >= 0:
                own = distance_with_heading(road, lane, x, y, heading)
                lane = left if distance_with_heading(road, left, x, y, heading) <= own else lane
            scene.lane[b, i] = scene.target_lane[b, i] = lane
            search_neighbours(b, i, scene)
