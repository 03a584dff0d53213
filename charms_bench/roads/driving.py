"""How vehicles on a network decide: routes, meta-actions, IDM, MOBIL and steering.

Each function names the function of highway-env that it follows, operation for operation.
"""

import numpy as np

from charms_bench.engine.meta_actions import index_of
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.compiled import (
    clip,
    compiled,
    inlined,
    not_zero,
    row_after,
    wrap_to_pi,
)
from charms_bench.roads.linear_vehicles import linear_acceleration, linear_steering
from charms_bench.roads.locating import (
    as_followed,
    coordinates_of,
    distance_to,
    heading_on,
    width_on,
)
from charms_bench.roads.safe_gap import is_safe
from charms_bench.roads.scenes import (
    AHEAD,
    BATCH,
    COMMANDED,
    CONTINUOUS,
    EXPONENT,
    FREE,
    HEADING,
    IDM,
    LATERAL,
    LENGTH,
    OBSTACLE,
    SPEED,
    SPEED_RATIO,
    STEERING,
    Here,
    Row,
    batch_of,
    batched,
    lane_of,
    number_of,
    put,
    vehicle_of,
)
from charms_bench.roads.vehicle_order import neighbours
from charms_bench.world import idm_mobil
from charms_bench.world.actions import FASTER, LANE_LEFT, LANE_RIGHT, SLOWER
from charms_bench.world.bicycle import slip_to_turn, steering_of, towards_centre, towards_speed
from charms_bench.world.idm_mobil import closing_speed, desired_gap, imposes_braking, mobil
from charms_bench.world.lane_geometry import END_MARGIN_M
from charms_bench.world.road import next_lane
from charms_bench.world.road_network import Network, leads_to


@compiled
def command(road: Network, speeds: Floats, here: Here, i: int, action: int) -> None:
    """Carries out a meta-action, which chooses between target speeds or lanes.

    [`MDPVehicle.act`, `ControlledVehicle.act`]
    """
    vehicle = vehicle_of(here, i)
    if action in (FASTER, SLOWER):
        change = 1 if action == FASTER else -1
        wanted = index_of(vehicle.speed, speeds) + change
        vehicle.speed_index = min(max(wanted, 0), speeds.size - 1)
        vehicle.target_speed = speeds[vehicle.speed_index]
    if is_at_end(here, i):
        take_next_lane(road, here, i)
    if action in (LANE_LEFT, LANE_RIGHT):
        target = lane_of(here, vehicle.target_lane)
        beside = target.right if action == LANE_RIGHT else target.left
        lane = beside if beside >= 0 else vehicle.target_lane
        if is_reachable(here, i, lane):
            vehicle.target_lane = lane


@compiled
def act(road: Network, here: Here) -> None:
    """Has the vehicles of a scene decide, one after the other [`Road.act`].

    What does not depend on the decisions of others is computed for all of them at once.
    """
    find_free_accelerations(here)
    list_changing(here)
    for i in range(here.places):
        vehicle = vehicle_of(here, i)
        was_changing = vehicle.lane != vehicle.target_lane
        if vehicle.kind == COMMANDED:
            if is_at_end(here, i):
                take_next_lane(road, here, i)
            tau_s = here.constants.tau_acceleration
            vehicle.acceleration = towards_speed(vehicle.speed, vehicle.target_speed, tau_s)
        elif vehicle.kind == IDM and not vehicle.crashed:
            if is_at_end(here, i):
                take_next_lane(road, here, i)
            act_as_idm(here, i)
        if vehicle.lane != vehicle.target_lane and not was_changing:
            note_changing(here, i)
    steer(here)


@inlined
def list_changing(here: Here) -> None:
    """Lists the vehicles that change lanes."""
    here.clock.changing = 0
    for i in range(here.places):
        vehicle = vehicle_of(here, i)
        if vehicle.lane != vehicle.target_lane:
            note_changing(here, i)


@inlined
def note_changing(here: Here, i: int) -> None:
    """Lists vehicle i, which changes lanes."""
    row_after(here.visited, here.clock.changing).changing = i
    here.clock.changing += 1


@compiled
def act_as_idm(here: Here, i: int) -> None:
    """[`IDMVehicle.act`, but for the steering], also of linear vehicles."""
    vehicle, limit = vehicle_of(here, i), here.constants.acceleration_limit_mps2
    front, rear = neighbours(here, i, vehicle.lane)
    free = vehicle.free_acceleration
    own = following_acceleration(here, i, front, free)
    if vehicle.changes_lanes:
        choose_lane(here, i, free, own, front, rear)
    if vehicle.lane != vehicle.target_lane:
        front, _ = neighbours(here, i, vehicle.target_lane)
        own = min(own, following_acceleration(here, i, front, free))
    vehicle.acceleration = clip(own, -limit, limit)


@inlined
def is_at_end(here: Here, i: int) -> bool:
    """Whether a vehicle is at the end of its target lane [`AbstractLane.after_end`]."""
    target = vehicle_of(here, i).target_lane
    end = lane_of(here, target).length - END_MARGIN_M / 2
    return bool(coordinates_of(here, i, target).s > end)


@compiled
def take_next_lane(road: Network, here: Here, i: int) -> None:
    """Targets the next lane by the route, where `is_at_end` [`ControlledVehicle.follow_road`]."""
    vehicle = vehicle_of(here, i)
    target, next_road, next_number = vehicle.target_lane, -1, -1
    row = lane_of(here, target)
    if vehicle.route_step < vehicle.route_end:
        vehicle.route_step += vehicle.route_roads[vehicle.route_step] == row.first
    if row.next_count == 0:  # `next_lane` would find none
        return
    if vehicle.route_step < vehicle.route_end:
        first = vehicle.route_roads[vehicle.route_step]
        if leads_to(road, target, first):
            next_road, next_number = first, vehicle.route_numbers[vehicle.route_step]
    vehicle.target_lane = next_lane(road, target, next_road, next_number, vehicle.x, vehicle.y)


@compiled
def steer(here: Here) -> None:
    """Steers vehicles towards their target lanes [`ControlledVehicle.steering_control`]."""
    c, count = here.constants, 0
    for i in range(here.places):
        vehicle = vehicle_of(here, i)
        if vehicle.kind < COMMANDED or (vehicle.kind == IDM and vehicle.crashed):
            continue
        if vehicle.kind == IDM and c.is_linear:
            vehicle.steering = linear_steering(here, i)
            continue
        at = coordinates_of(here, i, vehicle.target_lane)
        ahead = at.s + vehicle.speed * (0.5 * c.tau_heading)
        wanted = heading_on(here, lane_of(here, vehicle.target_lane), ahead)
        if at.r == 0.0 and wanted == vehicle.heading:
            vehicle.steering = 0.0
            continue
        batch, k = batch_of(here, count), count % BATCH
        row_after(here.visited, count).batched = i
        put(batch, LATERAL, k, at.r)
        put(batch, AHEAD, k, wanted)
        put(batch, HEADING, k, vehicle.heading)
        put(batch, LENGTH, k, vehicle.length)
        put(batch, SPEED, k, not_zero(vehicle.speed))
        count += 1
    for n in range(0, count, BATCH):
        turn_to_lanes(batch_of(here, n), c)
    for n in range(count):
        batch, k = batch_of(here, n), n % BATCH
        put(batch, AHEAD, k, wrap_to_pi(number_of(batch, AHEAD, k)))
    for n in range(0, count, BATCH):
        steer_batch(batch_of(here, n), c)
    for n in range(count):
        steering = number_of(batch_of(here, n), STEERING, n % BATCH)
        vehicle_of(here, batched(here, n)).steering = steering


@compiled
def turn_to_lanes(batch: Row, c: Row) -> None:
    """Finds the angles to the directions that lead to the middle of the lane ahead."""
    tau_s = c.tau_lateral
    for k in range(BATCH):
        angle = towards_centre(number_of(batch, LATERAL, k), number_of(batch, SPEED, k), tau_s)
        put(batch, AHEAD, k, number_of(batch, AHEAD, k) + angle - number_of(batch, HEADING, k))


@compiled
def steer_batch(batch: Row, c: Row) -> None:
    """Finds the steering angles with which vehicles turn by the angles `AHEAD`."""
    tau_s, limit = c.tau_heading, c.steering_limit
    for k in range(BATCH):
        speed, half_length = number_of(batch, SPEED, k), number_of(batch, LENGTH, k) / 2
        slip = slip_to_turn(number_of(batch, AHEAD, k), speed, half_length, tau_s)
        put(batch, STEERING, k, clip(steering_of(maths.tan(slip)), -limit, limit))


@inlined
def is_reachable(here: Here, i: int, lane: int) -> bool:
    """Whether vehicle i may change to a lane [`AbstractLane.is_reachable_from`]."""
    row, at = lane_of(here, lane), coordinates_of(here, i, lane)
    is_beside = abs(at.r) <= 2 * width_on(here, row, at.s)
    is_close = is_beside and 0 <= at.s < row.length + END_MARGIN_M
    return is_close and not row.forbidden


@compiled
def find_free_accelerations(here: Here) -> None:
    """Finds the `free_acceleration` of the vehicles that IDM drives, by their own exponents."""
    count = 0
    for i in range(here.places):
        vehicle = vehicle_of(here, i)
        if vehicle.kind == IDM and not vehicle.crashed:
            batch, k = batch_of(here, count), count % BATCH
            row_after(here.visited, count).batched = i
            put(batch, SPEED_RATIO, k, speed_ratio(here, i))
            put(batch, EXPONENT, k, vehicle.exponent)
            count += 1
    for n in range(0, count, BATCH):
        accelerate_freely(batch_of(here, n), here.constants.acceleration_mps2)
    for n in range(count):
        free = number_of(batch_of(here, n), FREE, n % BATCH)
        vehicle_of(here, batched(here, n)).free_acceleration = free


@compiled
def accelerate_freely(batch: Row, acceleration: float) -> None:
    """Finds the free accelerations of a batch, given that of a vehicle at rest.

    A loop over the powers alone would be unrolled before it could be vectorised.
    """
    for k in range(BATCH):
        ratio, exponent = number_of(batch, SPEED_RATIO, k), number_of(batch, EXPONENT, k)
        put(batch, FREE, k, idm_mobil.free_acceleration(ratio, exponent, acceleration))


@inlined
def speed_ratio(here: Here, i: int) -> float:
    """The speed of vehicle i divided by its target speed."""
    vehicle = vehicle_of(here, i)
    limit = lane_of(here, vehicle.lane).speed_limit
    return idm_mobil.speed_ratio(vehicle.speed, vehicle.target_speed, limit)


@compiled
def free_acceleration(here: Here, i: int, exponent: float) -> float:
    """The acceleration of vehicle i on a free road."""
    most = here.constants.acceleration_mps2
    return idm_mobil.free_acceleration(speed_ratio(here, i), exponent, most)


@compiled
def interaction(here: Here, i: int, j: int) -> float:
    """The deceleration of vehicle i behind vehicle j, -1 for none."""
    if j < 0:
        return 0.0
    most = here.constants.acceleration_mps2
    return idm_mobil.interaction(wanted_gap(here, i, j), distance_to(here, i, j), most)


@inlined
def own_acceleration(here: Here, i: int, j: int, free: float) -> float:
    """The acceleration of vehicle i behind vehicle j; `free` is its `free_acceleration`."""
    if here.constants.is_linear:
        return linear_acceleration(here, i, j, i)
    return free - interaction(here, i, j)


@inlined
def following_acceleration(here: Here, i: int, j: int, free: float) -> float:
    """The acceleration of vehicle i behind its neighbour j, which has just been found.

    Where a road `looks_ahead`, the distance and the closing speed are those along the lanes.
    highway-env measures both along the vehicle's own lane and heading, so that after a turn, a
    vehicle far away can seem to be close.
    """
    if not here.constants.looks_ahead or j < 0:
        return own_acceleration(here, i, j, free)
    speed, p = vehicle_of(here, i).speed, here.constants
    wanted = desired_gap(speed, speed - vehicle_of(here, j).speed, p)
    gap = as_followed(here, i, j, here.clock.gap)
    return free - idm_mobil.interaction(wanted, gap, p.acceleration_mps2)


@inlined
def expected_acceleration(driver: tuple[Here, int], i: int, j: int) -> float:
    """The acceleration that a driver of a scene expects of vehicle i behind vehicle j.

    Of what is no vehicle, IDM expects 0 [`IDMVehicle.acceleration`].
    """
    here, own = driver
    if here.constants.is_linear:
        return linear_acceleration(here, i, j, own)
    if i < 0 or vehicle_of(here, i).kind <= OBSTACLE:
        return 0.0
    return free_acceleration(here, i, vehicle_of(here, own).exponent) - interaction(here, i, j)


@inlined
def wanted_gap(here: Here, i: int, j: int) -> float:
    """The gap that vehicle i wants behind vehicle j, m."""
    own = vehicle_of(here, i)
    return desired_gap(own.speed, closing_speed(own, vehicle_of(here, j)), here.constants)


@inlined
def choose_lane(here: Here, i: int, free: float, own: float, front: int, rear: int) -> None:
    """[`IDMVehicle.change_lane_policy`] The last four arguments are those of `changes`."""
    vehicle = vehicle_of(here, i)
    if vehicle.lane != vehicle.target_lane:
        own_road = lane_of(here, vehicle.lane).first
        if own_road == lane_of(here, vehicle.target_lane).first:
            is_taken = gap_is_taken(here, i)
            if here.constants.looks_ahead and not is_taken:
                is_taken = not is_safe(here, i, vehicle.target_lane)
            if is_taken:
                vehicle.target_lane = vehicle.lane
    elif vehicle.timer_s > here.constants.lane_change_period_s:
        vehicle.timer_s = 0.0
        if not abs(vehicle.speed) < 1 or here.constants.looks_ahead:
            consider_sides(here, i, free, own, front, rear)


@compiled
def consider_sides(here: Here, i: int, free: float, own: float, front: int, rear: int) -> None:
    """The part of `change_lane_policy` that asks MOBIL about both sides."""
    vehicle = vehicle_of(here, i)
    row = lane_of(here, vehicle.lane)
    for side in (row.left, row.right):
        if side < 0 or not is_reachable(here, i, side):
            continue
        if changes(here, i, side, free, own, front, rear):
            vehicle.target_lane = side


@compiled
def gap_is_taken(here: Here, i: int) -> bool:
    """Whether another vehicle changes to the same lane close ahead [`change_lane_policy`]."""
    target = vehicle_of(here, i).target_lane
    for k in range(here.clock.changing):
        j = row_after(here.visited, k).changing
        other = vehicle_of(here, j)
        if j == i or other.kind <= CONTINUOUS:
            continue
        is_changing = other.lane != target and other.target_lane == target
        if is_changing and 0 < distance_to(here, i, j) < wanted_gap(here, i, j):
            return True
    return False


@compiled
def changes(here: Here, i: int, lane: int, free: float, own: float, front: int, rear: int) -> bool:
    """Whether to change to a lane [`IDMVehicle.mobil`].

    `free` and `own` are the accelerations on a free road and on the present lane, on which
    `front` and `rear` are the neighbours. A route decides by itself what is gained.
    """
    vehicle, driver, p = vehicle_of(here, i), (here, i), here.constants
    new_front, new_rear = neighbours(here, i, lane)
    own_after = own_acceleration(here, i, new_front, free)
    step, wanted = vehicle.route_step, -1
    if step < vehicle.route_end:
        wanted = vehicle.route_numbers[step]
    if wanted < 0:
        gain, behind, ahead = own_after - own, (rear, new_rear), (front, new_front)
        return mobil(expected_acceleration, driver, gain, i, behind, ahead, p)
    number = vehicle.target_lane - lane_of(here, vehicle.target_lane).first
    side = lane - lane_of(here, lane).first
    if np.sign(side - number) != np.sign(wanted - number) or imposes_braking(own_after, p):
        return False
    return not imposes_braking(expected_acceleration(driver, new_rear, i), p)
