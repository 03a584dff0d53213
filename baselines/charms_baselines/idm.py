"""IDM on the straight road: the formulas of `world.idm_mobil`, applied to vehicles of a scene."""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.compiled import compiled, index, inlined
from charms_bench.world import idm_mobil
from charms_bench.world.candidate_lanes import CANDIDATES, OWN
from charms_bench.world.gaps import following_distance, overhang
from charms_bench.world.idm_mobil import (
    Velocity,
    closing_speed,
    desired_gap,
    free_acceleration,
    speed_ratio,
)
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.road import Straight, distance_along
from charms_bench.world.scene import Floats, Ints, Scene


class Motion(NamedTuple):
    """The state of a vehicle that the model uses.

    It has numbers only, because passing arrays for every vehicle would take longer than the model.
    """

    exists: bool
    """Everything else means nothing if not."""
    x: float
    y: float
    lane: int
    speed: float
    direction_x: float
    direction_y: float
    target_speed: float
    overhang: float


@inlined
def motion(b: int, i: int, scene: Scene) -> Motion:
    """The motion of vehicle i of scene b; -1 is a vehicle that does not exist."""
    if i < 0:
        return Motion(False, 0.0, 0.0, 0, 0.0, 1.0, 0.0, 0.0, 0.0)
    return Motion(
        True,
        scene.x[b, i],
        scene.y[b, i],
        scene.lane[b, i],
        scene.speed[b, i],
        scene.direction_x[b, i],
        scene.direction_y[b, i],
        scene.target_speed[b, i],
        overhang(scene.length[b, i], scene.constants.length),
    )


@inlined
def distance(road: Straight, vehicle: Motion, leader: Motion) -> float:
    """The distance to a leader along the vehicle's lane, m; infinite if one does not exist.

    [`RoadObject.lane_distance_to`]; see `following_distance`.
    """
    if not (vehicle.exists and leader.exists):
        return math.inf
    here, there = (vehicle.x, vehicle.y), (leader.x, leader.y)
    centres = distance_along(road, vehicle.lane, *here, *there)
    return float(following_distance(centres, vehicle.overhang, leader.overhang))


@compiled
def interaction(road: Straight, vehicle: Motion, leader: Motion, p: IdmMobilParameters) -> float:
    """The deceleration of a vehicle behind a leader, m/s2."""
    wanted = desired_gap(vehicle.speed, closing_speed(vehicle, leader), p)
    return idm_mobil.interaction(wanted, distance(road, vehicle, leader), p.acceleration_mps2)


@compiled
def on_own_lane(
    scene: Scene, rows: Ints, places: Ints, exponents: Floats, p: IdmMobilParameters
) -> tuple[Floats, Floats]:
    """IDM accelerations of M vehicles on a free road, and behind the leaders on their lanes.

    It computes the same as `following`, in loops that vectorise.
    """
    c, road, vehicles = scene.constants, scene.road, scene.x.shape[1]
    x, speed, target_speed = scene.x.ravel(), scene.speed.ravel(), scene.target_speed.ravel()
    direction_x, direction_y = scene.direction_x.ravel(), scene.direction_y.ravel()
    y, lane, leaders, length = (
        scene.y.ravel(),
        scene.lane.ravel(),
        scene.leaders.ravel(),
        scene.length.ravel(),
    )
    free, wanted = np.empty(rows.size), np.empty(rows.size)
    gap = np.empty(rows.size)
    for m in range(rows.size):
        i = index(rows[m] * vehicles + places[m])
        leader = leaders[index((rows[m] * vehicles + places[m]) * len(CANDIDATES) + OWN)]
        j = index(rows[m] * vehicles + leader) if leader >= 0 else i
        v, ux, uy = speed[i], direction_x[i], direction_y[i]
        free[m] = speed_ratio(v, target_speed[i], road.speed_limit)
        leading = Velocity(speed[j], direction_x[j], direction_y[j])
        wanted[m] = desired_gap(v, closing_speed(Velocity(v, ux, uy), leading), p)
        gap[m] = distance_along(road, lane[i], x[i], y[i], x[j], y[j])
        gap[m] = gap[m] if leader >= 0 else math.inf
    for m in range(rows.size if c.mixed_sizes else 0):
        i = rows[m] * vehicles + places[m]
        leader = leaders[index(i * len(CANDIDATES) + OWN)]
        j = rows[m] * vehicles + leader if leader >= 0 else i
        own, other = overhang(length[index(i)], c.length), overhang(length[index(j)], c.length)
        gap[m] = following_distance(gap[m], own, other)
    for m in range(rows.size):
        free[m] = free_acceleration(free[m], exponents[m], p.acceleration_mps2)
    for m in range(rows.size):
        wanted[m] = free[m] - idm_mobil.interaction(wanted[m], gap[m], p.acceleration_mps2)
    return free, wanted


@compiled
def following(
    driver: tuple[Straight, float, IdmMobilParameters], vehicle: Motion, leader: Motion
) -> float:
    """IDM acceleration behind a leader, m/s2, as a driver expects it [`IDMVehicle.acceleration`].

    A vehicle that does not exist accelerates by 0. A driver is road, exponent and parameters.
    """
    if not vehicle.exists:
        return 0.0
    road, exponent, p = driver
    ratio = speed_ratio(vehicle.speed, vehicle.target_speed, road.speed_limit)
    free = free_acceleration(ratio, exponent, p.acceleration_mps2)
    return free - interaction(road, vehicle, leader, p)
