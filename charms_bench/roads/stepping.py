"""How vehicles on a network move and collide, step by step [`Road.step`]."""

import math

import numpy as np

from charms_bench.engine.collision_detection import fill_polygon, polygons_intersect
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, inlined
from charms_bench.roads.driving import act, command
from charms_bench.roads.dynamics import move_with_slip
from charms_bench.roads.locating import forget, locate
from charms_bench.roads.scenes import (
    COMMANDED,
    CONTINUOUS,
    DYNAMICAL,
    IDM,
    OBSTACLE,
    Here,
    Row,
    Scenes,
    here_of,
    vehicle_of,
)


@compiled_of_scenes
def decide(scenes: Scenes, rows: Ints, actions: Ints, frames: int, interval: float) -> None:
    """Advances the scenes `rows` by a decision: the egos' meta-actions (B,), and so many steps.

    Egos that are not commanded have been given what they do. [`AbstractEnv._simulate`]
    """
    corners = np.empty((2, 4, 2))
    for b in rows:
        here = here_of(scenes, b)
        scenes.time[b] += interval
        for i in range(here.places):
            forget(here, i)
        if vehicle_of(here, 0).kind == COMMANDED:
            command(scenes, here, 0, actions[b])
        for _ in range(frames):
            act(scenes.road, here)
            for i in range(here.places):
                if vehicle_of(here, i).kind > OBSTACLE and not is_at_rest(vehicle_of(here, i)):
                    limit(here, i)
                    if vehicle_of(here, i).kind == DYNAMICAL:
                        move_with_slip(vehicle_of(here, i), here.constants.dt)
                    else:
                        move(here, i)
                    locate(here, i)
            collide(here, corners)


@inlined
def is_at_rest(vehicle: Row) -> bool:
    """Whether a vehicle certainly stays where it is, as one that is parked does."""
    is_still = vehicle.speed == 0.0 and not vehicle.has_impact
    is_idle = vehicle.acceleration == 0.0 and vehicle.steering == 0.0
    return bool(vehicle.kind == CONTINUOUS and is_still and is_idle)


@inlined
def limit(here: Here, i: int) -> None:
    """Has a crashed vehicle stop, and one that is too fast or too slow [`Vehicle.clip_actions`]."""
    vehicle = vehicle_of(here, i)
    speed = vehicle.speed
    if vehicle.crashed:
        vehicle.steering, vehicle.acceleration = 0.0, -1.0 * speed
    if speed > vehicle.speed_max:
        vehicle.acceleration = min(vehicle.acceleration, 1.0 * (vehicle.speed_max - speed))
    elif speed < vehicle.speed_min:
        vehicle.acceleration = max(vehicle.acceleration, 1.0 * (vehicle.speed_min - speed))


@compiled
def move(here: Here, i: int) -> None:
    """Moves a vehicle by one step of the kinematic bicycle model [`Vehicle.step`]."""
    vehicle, c = vehicle_of(here, i), here.constants
    speed = vehicle.speed
    if vehicle.kind == IDM:
        vehicle.timer_s += c.dt
    if vehicle.steering == 0.0:  # the functions below would give 0 and the direction itself
        vehicle.x += speed * vehicle.direction_x * c.dt
        vehicle.y += speed * vehicle.direction_y * c.dt
    else:
        slip = maths.atan(1 / 2 * maths.tan(vehicle.steering))
        sine, cosine = maths.sin_cos(vehicle.heading + slip)
        vehicle.x += speed * cosine * c.dt
        vehicle.y += speed * sine * c.dt
        vehicle.heading += speed * maths.sin(slip) / (vehicle.length / 2) * c.dt
        vehicle.direction_y, vehicle.direction_x = maths.sin_cos(vehicle.heading)
    if vehicle.has_impact:
        vehicle.x += vehicle.impact_x
        vehicle.y += vehicle.impact_y
        vehicle.crashed, vehicle.has_impact = True, False
    vehicle.speed += vehicle.acceleration * c.dt


@compiled
def collide(here: Here, corners: Floats) -> None:
    """Finds the collisions of pairs, in their order [`RoadObject.handle_collisions`].

    `corners` (2, 4, 2) is overwritten.
    """
    dt = here.constants.dt
    for i in range(here.places):
        own = vehicle_of(here, i)
        if own.kind <= OBSTACLE:
            continue
        diagonal = math.sqrt(own.length**2 + own.width**2)
        for j in range(i + 1, here.places):
            other = vehicle_of(here, j)
            if other.kind < OBSTACLE or not (own.checks_collisions or other.checks_collisions):
                continue
            dx, dy = other.x - own.x, other.y - own.y
            sizes = own.length + own.width + other.length + other.width
            if abs(dx) > sizes + abs(own.speed) * dt:
                continue  # before the square roots, which would say the same
            reach = (diagonal + math.sqrt(other.length**2 + other.width**2)) / 2 + own.speed * dt
            if math.sqrt(dx * dx + dy * dy) > reach:
                continue
            for k, each in enumerate((own, other)):
                direction = each.direction_x, each.direction_y
                size = each.length, each.width
                fill_polygon(each.x, each.y, *direction, *size, corners[k])
            relative_x = own.speed * own.direction_x * dt - other.speed * other.direction_x * dt
            relative_y = own.speed * own.direction_y * dt - other.speed * other.direction_y * dt
            now, soon, part_x, part_y = polygons_intersect(
                corners[0], corners[1], relative_x, relative_y
            )
            if soon and other.kind == OBSTACLE:
                own.impact_x, own.impact_y, own.has_impact = part_x, part_y, True
            elif soon:
                own.impact_x, own.impact_y, own.has_impact = part_x / 2, part_y / 2, True
                other.impact_x, other.impact_y, other.has_impact = -part_x / 2, -part_y / 2, True
            if now:
                own.crashed = other.crashed = True
