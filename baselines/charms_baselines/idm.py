"""The Intelligent Driver Model (Treiber et al. 2000) as highway-env computes it, compiled."""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, compiled, index, inlined, not_zero
from charms_bench.world.candidate_lanes import CANDIDATES, OWN
from charms_bench.world.gaps import following_distance, overhang
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.scene import Floats, Ints, Scene


class Motion(NamedTuple):
    """The state of a vehicle that the model uses.

    It has numbers only, because passing arrays to a compiled function for every vehicle would take
    longer than the model itself.
    """

    x: float
    speed: float
    direction_x: float
    direction_y: float
    wanted_speed: float
    overhang: float


@compiled
def motion(b: int, i: int, scene: Scene) -> Motion:
    """The motion of vehicle i of scene b."""
    return Motion(
        scene.x[b, i],
        scene.speed[b, i],
        scene.direction_x[b, i],
        scene.direction_y[b, i],
        clip(scene.target_speed[b, i], 0.0, scene.constants.speed_limit),
        overhang(scene.length[b, i], scene.constants.length),
    )


@compiled
def motion_ahead(b: int, i: int, scene: Scene) -> Motion:
    """The motion of a leader; if there is none (-1), it is infinitely far ahead."""
    return Motion(math.inf, 0.0, 1.0, 0.0, 0.0, 0.0) if i < 0 else motion(b, i, scene)


@compiled
def motion_behind(b: int, i: int, scene: Scene) -> Motion:
    """The motion of a follower; if there is none (-1), it is infinitely far behind."""
    return Motion(-math.inf, 0.0, 1.0, 0.0, 0.0, 0.0) if i < 0 else motion(b, i, scene)


@inlined
def distance(vehicle: Motion, leader: Motion) -> float:
    """The distance to a leader, m [`RoadObject.lane_distance_to`]; see `following_distance`."""
    overhangs = vehicle.overhang, leader.overhang
    return float(following_distance(vehicle.x, leader.x, *overhangs))


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
def interaction(vehicle: Motion, leader: Motion, p: IdmMobilParameters) -> float:
    """IDM deceleration behind a leader, m/s2, Treiber et al. 2000 eq. 3, second part."""
    wanted = desired_gap(vehicle.speed, closing_speed(vehicle, leader), p)
    crowding = wanted / not_zero(distance(vehicle, leader))
    return p.acceleration_mps2 * (crowding * crowding)


@compiled
def on_own_lane(
    scene: Scene, rows: Ints, places: Ints, exponents: Floats, p: IdmMobilParameters
) -> tuple[Floats, Floats]:
    """IDM accelerations of M vehicles on a free road, and behind the leaders on their lanes.

    It computes the same as `free_acceleration` and `following`, in loops that vectorise.
    """
    c, vehicles = scene.constants, scene.x.shape[1]
    x, speed, wanted_speed = scene.x.ravel(), scene.speed.ravel(), scene.target_speed.ravel()
    direction_x, direction_y = scene.direction_x.ravel(), scene.direction_y.ravel()
    leaders, length = scene.leaders.ravel(), scene.length.ravel()
    free, wanted = np.empty(rows.size), np.empty(rows.size)
    gap = np.empty(rows.size)
    for m in range(rows.size):
        i = index(rows[m] * vehicles + places[m])
        leader = leaders[index((rows[m] * vehicles + places[m]) * len(CANDIDATES) + OWN)]
        j = index(rows[m] * vehicles + leader) if leader >= 0 else i
        v, ux, uy = speed[i], direction_x[i], direction_y[i]
        free[m] = max(v, 0.0) / abs(not_zero(clip(wanted_speed[i], 0.0, c.speed_limit)))
        ahead, aside = v * ux - speed[j] * direction_x[j], v * uy - speed[j] * direction_y[j]
        wanted[m] = desired_gap(v, ahead * ux + aside * uy, p)
        gap[m] = x[j] - x[i] if leader >= 0 else math.inf
    for m in range(rows.size if c.mixed_sizes else 0):
        i = rows[m] * vehicles + places[m]
        leader = leaders[index(i * len(CANDIDATES) + OWN)]
        j = rows[m] * vehicles + leader if leader >= 0 else i
        own, other = overhang(length[index(i)], c.length), overhang(length[index(j)], c.length)
        gap[m] = following_distance(0.0, gap[m], own, other)
    for m in range(rows.size):
        free[m] = p.acceleration_mps2 * (1 - maths.power(free[m], exponents[m]))
    for m in range(rows.size):
        crowding = wanted[m] / not_zero(gap[m])
        wanted[m] = free[m] - p.acceleration_mps2 * (crowding * crowding)
    return free, wanted


@compiled
def following(vehicle: Motion, leader: Motion, exponent: float, p: IdmMobilParameters) -> float:
    """IDM acceleration behind a leader, m/s2 [`IDMVehicle.acceleration`].

    A vehicle that does not exist accelerates by 0. `exponent` is that of the deciding driver.
    """
    if vehicle.x == -math.inf:
        return 0.0
    return free_acceleration(vehicle, exponent, p) - interaction(vehicle, leader, p)
