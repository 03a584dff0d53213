"""How vehicles on a network move and collide, step by step [`Road.step`]."""

import math

import numpy as np

from charms_bench.engine.collision_detection import fill_polygon, polygons_intersect
from charms_bench.foundation.arrays import Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, inlined, row_after
from charms_bench.roads.driving import act, command
from charms_bench.roads.dynamics import finish, go_straight, move_with_slip, prepare, turn_batch
from charms_bench.roads.locating import are_above, forget, locate
from charms_bench.roads.looking_ahead import look_ahead
from charms_bench.roads.regulated_road import enforce
from charms_bench.roads.scenes import (
    BATCH,
    COMMANDED,
    CONTINUOUS,
    COSINE,
    DYNAMICAL,
    FEW_VEHICLES,
    HEADING,
    LENGTH,
    OBSTACLE,
    SINE,
    SPEED,
    STEERING,
    Here,
    Row,
    Scenes,
    X,
    Y,
    batch_of,
    batched,
    here_of,
    number_of,
    place_of,
    put,
    vehicle_of,
)
from charms_bench.world.road_network import Network

MARGIN_M = 1e-6
"""So that rounding does not decide whether two vehicles are certainly apart."""


@compiled_of_scenes
def decide(scenes: Scenes, rows: Ints, actions: Ints, frames: int, interval: float) -> None:
    """Advances the scenes `rows` by a decision: meta-actions (B, A), and so many steps.

    The first A vehicles are given one each; those that are not commanded have been given what they
    do. [`AbstractEnv._simulate`]
    """
    road, speeds, steps, time = scenes.road, scenes.target_speeds, scenes.steps, scenes.time
    for b in rows:
        here = here_of(scenes, b)
        time[b] += interval
        for i in range(here.places):
            forget(here, i)
        for i in range(actions.shape[1]):
            if vehicle_of(here, i).kind == COMMANDED:
                command(road, speeds, here, i, actions[b, i])
        advance(road, steps, b, here, frames)


@compiled
def advance(road: Network, steps: Ints, b: int, here: Here, frames: int) -> None:
    """Advances scene b by so many simulation steps; `steps` (B,) are those of `Scenes`."""
    for _ in range(frames):
        if here.constants.looks_ahead:
            look_ahead(here)
        act(road, here)
        if here.constants.regulation_steps:
            steps[b] += 1
            if steps[b] % here.constants.regulation_steps == 0:
                enforce(road, here)
        move_all(here)
        collide(here)


@compiled
def move_all(here: Here) -> None:
    """Moves the vehicles of a scene by a step and finds their nearest lanes.

    Those that turn are moved at once.
    """
    dt, count = here.constants.dt, 0
    for i in range(here.places):
        vehicle = vehicle_of(here, i)
        if vehicle.kind <= OBSTACLE or is_at_rest(vehicle):
            continue
        prepare(vehicle, dt)
        if vehicle.kind == DYNAMICAL:
            move_with_slip(vehicle, dt)
        elif vehicle.steering == 0.0:
            go_straight(vehicle, dt)
            finish(vehicle, dt)
        else:
            batch, k = batch_of(here, count), count % BATCH
            row_after(here.visited, count).batched = i
            put(batch, HEADING, k, vehicle.heading)
            put(batch, STEERING, k, vehicle.steering)
            put(batch, SPEED, k, vehicle.speed)
            put(batch, LENGTH, k, vehicle.length)
            count += 1
            continue
        locate(here, i)
    for n in range(0, count, BATCH):
        turn_batch(batch_of(here, n), dt)
    for n in range(count):
        batch, k = batch_of(here, n), n % BATCH
        vehicle = vehicle_of(here, batched(here, n))
        vehicle.x += number_of(batch, X, k)
        vehicle.y += number_of(batch, Y, k)
        vehicle.heading = number_of(batch, HEADING, k)
        vehicle.direction_x = number_of(batch, COSINE, k)
        vehicle.direction_y = number_of(batch, SINE, k)
        finish(vehicle, dt)
        locate(here, batched(here, n))


@inlined
def is_at_rest(vehicle: Row) -> bool:
    """Whether a vehicle certainly stays where it is, as one that is parked does."""
    is_still = vehicle.speed == 0.0 and not vehicle.has_impact
    is_idle = vehicle.acceleration == 0.0 and vehicle.steering == 0.0
    return bool(vehicle.kind == CONTINUOUS and is_still and is_idle)


@compiled
def collide(here: Here) -> None:
    """Finds the collisions of pairs, in their order [`RoadObject.handle_collisions`]."""
    if here.places <= FEW_VEHICLES:
        collide_all(here)
        return
    dt, count, furthest = here.constants.dt, list_bodies(here), 0.0
    for n in range(count):
        furthest = max(furthest, row_after(here.bodies, n).reach)
    for k in range(here.places):
        i = place_of(here, k)
        own = vehicle_of(here, i)
        if own.kind <= OBSTACLE:
            continue
        at = row_after(here.visited, i).at
        body, near = row_after(here.bodies, at), 0
        reach = body.reach + abs(own.speed) * dt
        for step in (1, -1):
            n = at + step
            while 0 <= n < count:
                other = row_after(here.bodies, n)
                if abs(other.x - body.x) > reach + furthest:
                    break
                is_later = row_after(here.visited, other.place).rank > k
                is_later = is_later and are_near(body, other, reach + other.reach)
                if is_later and not are_above(here, own.lane, vehicle_of(here, other.place).lane):
                    insert_by_rank(here, near, other.place)
                    near += 1
                n += step
        for n in range(near):
            collide_pair(own, vehicle_of(here, row_after(here.visited, n).touched), dt)


@compiled
def collide_all(here: Here) -> None:
    """As `collide`, for so few vehicles that looking at all pairs is faster."""
    dt, count = here.constants.dt, 0
    for k in range(here.places):
        vehicle = vehicle_of(here, place_of(here, k))
        if vehicle.kind >= OBSTACLE:
            describe(row_after(here.bodies, count), vehicle, place_of(here, k))
            count += 1
    for k in range(count):
        body = row_after(here.bodies, k)
        own = vehicle_of(here, body.place)
        if own.kind == OBSTACLE:
            continue
        reach = body.reach + abs(own.speed) * dt
        for m in range(k + 1, count):
            other = row_after(here.bodies, m)
            if not are_near(body, other, reach + other.reach):
                continue
            another = vehicle_of(here, other.place)
            if not are_above(here, own.lane, another.lane):
                collide_pair(own, another, dt)


@inlined
def describe(body: Row, vehicle: Row, place: int) -> None:
    """Notes a vehicle or an obstacle as the search for collisions sees it."""
    body.place, body.x, body.y = place, vehicle.x, vehicle.y
    body.checks = vehicle.checks_collisions
    body.reach = (vehicle.length + vehicle.width) / 2 + MARGIN_M


@inlined
def are_near(body: Row, other: Row, reach: float) -> bool:
    """Whether two may collide; square roots would say the same, but take longer."""
    if abs(other.x - body.x) > reach or abs(other.y - body.y) > reach:
        return False
    return bool(body.checks or other.checks)


@compiled
def list_bodies(here: Here) -> int:
    """Lists the vehicles and obstacles by x, and returns how many there are."""
    count, absent = 0, here.places
    for k in range(here.places):
        row_after(here.visited, place_of(here, k)).rank = k
    for n in range(here.places):
        i = row_after(here.visited, n).by_x
        vehicle = vehicle_of(here, i)
        if vehicle.kind < OBSTACLE:
            continue
        m = count
        while m > 0 and row_after(here.bodies, m - 1).x > vehicle.x:
            before, after = row_after(here.bodies, m - 1), row_after(here.bodies, m)
            after.place, after.x, after.y = before.place, before.x, before.y
            after.checks, after.reach = before.checks, before.reach
            m -= 1
        describe(row_after(here.bodies, m), vehicle, i)
        count += 1
    for i in range(here.places):
        if vehicle_of(here, i).kind < OBSTACLE:
            absent -= 1
            row_after(here.visited, absent).by_x = i
    for n in range(count):
        i = row_after(here.bodies, n).place
        row_after(here.visited, n).by_x = i
        row_after(here.visited, i).at = n
    return count


@inlined
def insert_by_rank(here: Here, count: int, place: int) -> None:
    """Puts a vehicle into the list `touched` of so many, in highway-env's order of vehicles."""
    rank, n = row_after(here.visited, place).rank, count
    while n > 0:
        before = row_after(here.visited, n - 1).touched
        if row_after(here.visited, before).rank < rank:
            break
        row_after(here.visited, n).touched = before
        n -= 1
    row_after(here.visited, n).touched = place


@compiled
def collide_pair(own: Row, other: Row, dt: float) -> None:
    """The part of `handle_collisions` for a pair that is close to each other."""
    dx, dy = other.x - own.x, other.y - own.y
    reach = (diagonal_of(own) + diagonal_of(other)) / 2 + own.speed * dt
    if math.sqrt(dx * dx + dy * dy) > reach:
        return
    relative_x = own.speed * own.direction_x * dt - other.speed * other.direction_x * dt
    relative_y = own.speed * own.direction_y * dt - other.speed * other.direction_y * dt
    if are_apart(own, other, relative_x, relative_y):
        return
    corners = np.empty((2, 4, 2))
    for n, each in enumerate((own, other)):
        direction = each.direction_x, each.direction_y
        fill_polygon(each.x, each.y, *direction, each.length, each.width, corners[n])
    now, soon, part_x, part_y = polygons_intersect(corners[0], corners[1], relative_x, relative_y)
    if soon and other.kind == OBSTACLE:
        own.impact_x, own.impact_y, own.has_impact = part_x, part_y, True
    elif soon:
        own.impact_x, own.impact_y, own.has_impact = part_x / 2, part_y / 2, True
        other.impact_x, other.impact_y, other.has_impact = -part_x / 2, -part_y / 2, True
    if now:
        own.crashed = other.crashed = True


@inlined
def diagonal_of(vehicle: Row) -> float:
    """The length of a vehicle's diagonal, m."""
    return math.sqrt(vehicle.length**2 + vehicle.width**2)


@inlined
def are_apart(own: Row, other: Row, relative_x: float, relative_y: float) -> bool:
    """Whether a direction of the first vehicle certainly separates two, now and within the step.

    `polygons_intersect` would say the same.
    """
    dx, dy = other.x - own.x, other.y - own.y
    cos, sin = own.direction_x, own.direction_y
    with_own = abs(cos * other.direction_x + sin * other.direction_y)
    across_own = abs(cos * other.direction_y - sin * other.direction_x)
    along = abs(cos * dx + sin * dy) - abs(cos * relative_x + sin * relative_y)
    beside = abs(cos * dy - sin * dx) - abs(cos * relative_y - sin * relative_x)
    length = own.length + other.length * with_own + other.width * across_own
    width = own.width + other.length * across_own + other.width * with_own
    return bool(along > length / 2 + MARGIN_M or beside > width / 2 + MARGIN_M)
