"""How vehicles on a network move and collide, step by step [`Road.step`]."""

import math

import numpy as np

from charms_bench.engine.collision_detection import fill_polygon, polygons_intersect
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, inlined
from charms_bench.roads.driving import act, command
from charms_bench.roads.dynamics import move
from charms_bench.roads.locating import forget, locate
from charms_bench.roads.right_of_way import enforce
from charms_bench.roads.scenes import (
    COMMANDED,
    CONTINUOUS,
    OBSTACLE,
    Here,
    Row,
    Scenes,
    here_of,
    place_of,
    vehicle_of,
)


@compiled_of_scenes
def decide(scenes: Scenes, rows: Ints, actions: Ints, frames: int, interval: float) -> None:
    """Advances the scenes `rows` by a decision: meta-actions (B, A), and so many steps.

    The first A vehicles are given one each; those that are not commanded have been given what they
    do. [`AbstractEnv._simulate`]
    """
    corners = np.empty((2, 4, 2))
    for b in rows:
        here = here_of(scenes, b)
        scenes.time[b] += interval
        for i in range(here.places):
            forget(here, i)
        for i in range(actions.shape[1]):
            if vehicle_of(here, i).kind == COMMANDED:
                command(scenes, here, i, actions[b, i])
        for _ in range(frames):
            advance(scenes, b, here, corners)


@compiled
def advance(scenes: Scenes, b: int, here: Here, corners: Floats) -> None:
    """Advances scene b by a simulation step. `corners` (2, 4, 2) is overwritten."""
    act(scenes.road, here)
    if here.constants.regulation_steps:
        scenes.steps[b] += 1
        if scenes.steps[b] % here.constants.regulation_steps == 0:
            enforce(scenes.road, here)
    for i in range(here.places):
        if vehicle_of(here, i).kind > OBSTACLE and not is_at_rest(vehicle_of(here, i)):
            move(vehicle_of(here, i), here.constants.dt)
            locate(here, i)
    collide(here, corners)


@inlined
def is_at_rest(vehicle: Row) -> bool:
    """Whether a vehicle certainly stays where it is, as one that is parked does."""
    is_still = vehicle.speed == 0.0 and not vehicle.has_impact
    is_idle = vehicle.acceleration == 0.0 and vehicle.steering == 0.0
    return bool(vehicle.kind == CONTINUOUS and is_still and is_idle)


@compiled
def collide(here: Here, corners: Floats) -> None:
    """Finds the collisions of pairs, in their order [`RoadObject.handle_collisions`].

    `corners` (2, 4, 2) is overwritten.
    """
    dt = here.constants.dt
    for k in range(here.places):
        own = vehicle_of(here, place_of(here, k))
        if own.kind <= OBSTACLE:
            continue
        diagonal = math.sqrt(own.length**2 + own.width**2)
        for m in range(k + 1, here.places):
            other = vehicle_of(here, place_of(here, m))
            if other.kind < OBSTACLE or not (own.checks_collisions or other.checks_collisions):
                continue
            dx, dy = other.x - own.x, other.y - own.y
            sizes = own.length + own.width + other.length + other.width
            if abs(dx) > sizes + abs(own.speed) * dt:
                continue  # before the square roots, which would say the same
            reach = (diagonal + math.sqrt(other.length**2 + other.width**2)) / 2 + own.speed * dt
            if math.sqrt(dx * dx + dy * dy) > reach:
                continue
            for n, each in enumerate((own, other)):
                direction = each.direction_x, each.direction_y
                size = each.length, each.width
                fill_polygon(each.x, each.y, *direction, *size, corners[n])
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
