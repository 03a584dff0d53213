"""The Intelligent Driver Model (Treiber et al. 2000) as highway-env computes it, compiled."""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, compiled, index, inlined, not_zero
from charms_bench.world.candidate_lanes import CANDIDATES, OWN
from charms_bench.world.gaps import following_distance, overhang
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.road import Straight, distance_along
from charms_bench.world.scene import Floats, Ints, Scene


class Motion(NamedTuple):
    """The state of a vehicle that the model uses.

    It has numbers only, because passing arrays to a compiled function for every vehicle would take
    longer than the model itself.
    """

    exists: bool
    """Everything else means nothing if not."""
    x: float
    y: float
    lane: int
    speed: float
    direction_x: float
    direction_y: float
    wanted_speed: float
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
        clip(scene.target_speed[b, i], 0.0, scene.road.speed_limit),
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
def desired_gap(speed: float, closing_speed: float, p: IdmMobilParameters) -> float:
    """Desired gap to a leader, centre to centre, m [`IDMVehicle.desired_gap`]."""
    braking = 2 * math.sqrt(p.acceleration_mps2 * p.deceleration_mps2)
    gap = p.jam_distance_m + speed * p.time_headway_s + speed * closing_speed / braking
    return float(max(gap, p.least_gap_m))


@compiled
def closing_speed(vehicle: Motion, leader: Motion) -> float:
    """Speed at which a vehicle approaches its leader, along its own heading, m/s."""
    ahead = vehicle.speed * vehicle.direction_x - leader.speed * leader.direction_x
    aside = vehicle.speed * vehicle.direction_y - leader.speed * leader.direction_y
    return ahead * vehicle.direction_x + aside * vehicle.direction_y


@compiled
def free_acceleration(vehicle: Motion, exponent: float, p: IdmMobilParameters) -> float:
    """IDM acceleration on a free road, m/s2, Treiber et al. 2000 eq. 3, first part."""
    share = max(vehicle.speed, 0.0) / abs(not_zero(vehicle.wanted_speed))
    return float(p.acceleration_mps2 * (1 - maths.power(share, exponent)))


@compiled
def interaction(road: Straight, vehicle: Motion, leader: Motion, p: IdmMobilParameters) -> float:
    """IDM deceleration behind a leader, m/s2, Treiber et al. 2000 eq. 3, second part."""
    wanted = desired_gap(vehicle.speed, closing_speed(vehicle, leader), p)
    crowding = wanted / not_zero(distance(road, vehicle, leader))
    return p.acceleration_mps2 * (crowding * crowding)


@compiled
def on_own_lane(
    scene: Scene, rows: Ints, places: Ints, exponents: Floats, p: IdmMobilParameters
) -> tuple[Floats, Floats]:
    """IDM accelerations of M vehicles on a free road, and behind the leaders on their lanes.

    It computes the same as `free_acceleration` and `following`, in loops that vectorise.
    """
    c, road, vehicles = scene.constants, scene.road, scene.x.shape[1]
    x, speed, wanted_speed = scene.x.ravel(), scene.speed.ravel(), scene.target_speed.ravel()
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
        free[m] = max(v, 0.0) / abs(not_zero(clip(wanted_speed[i], 0.0, road.speed_limit)))
        ahead, aside = v * ux - speed[j] * direction_x[j], v * uy - speed[j] * direction_y[j]
        wanted[m] = desired_gap(v, ahead * ux + aside * uy, p)
        gap[m] = distance_along(road, lane[i], x[i], y[i], x[j], y[j])
        gap[m] = gap[m] if leader >= 0 else math.inf
    for m in range(rows.size if c.mixed_sizes else 0):
        i = rows[m] * vehicles + places[m]
        leader = leaders[index(i * len(CANDIDATES) + OWN)]
        j = rows[m] * vehicles + leader if leader >= 0 else i
        own, other = overhang(length[index(i)], c.length), overhang(length[index(j)], c.length)
        gap[m] = following_distance(gap[m], own, other)
    for m in range(rows.size):
        free[m] = p.acceleration_mps2 * (1 - maths.power(free[m], exponents[m]))
    for m in range(rows.size):
        crowding = wanted[m] / not_zero(gap[m])
        wanted[m] = free[m] - p.acceleration_mps2 * (crowding * crowding)
    return free, wanted


@compiled
def following(
    road: Straight, vehicle: Motion, leader: Motion, exponent: float, p: IdmMobilParameters
) -> float:
    """IDM acceleration behind a leader, m/s2 [`IDMVehicle.acceleration`].

    A vehicle that does not exist accelerates by 0. `exponent` is that of the deciding driver.
    """
    if not vehicle.exists:
        return 0.0
    return free_acceleration(vehicle, exponent, p) - interaction(road, vehicle, leader, p)
