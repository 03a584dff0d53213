"""The Intelligent Driver Model (Treiber et al. 2000) as highway-env computes it, compiled.

A vehicle is meant by its scene `b` and its place; -1 is no vehicle, as in the neighbour tables.
"""

import math

from charms_bench.compiled import compiled
from charms_bench.scene import IdmMobilParameters, Scene


@compiled
def not_zero(value: float) -> float:
    """Keeps a divisor away from zero [`utils.not_zero`]."""
    if abs(value) > 1e-2:
        return value
    return 1e-2 if value >= 0 else -1e-2


@compiled
def desired_gap(b: int, vehicle: int, leader: int, scene: Scene, p: IdmMobilParameters) -> float:
    """Gap the vehicle wants to a leader, m, centre to centre [`IDMVehicle.desired_gap`]."""
    speed, heading = scene.speed[b, vehicle], scene.heading[b, vehicle]
    leader_speed, leader_heading = scene.speed[b, leader], scene.heading[b, leader]
    if heading == 0.0 and leader_heading == 0.0:
        closing = speed - leader_speed
    else:
        cos, sin = math.cos(heading), math.sin(heading)
        closing = (speed * cos - leader_speed * math.cos(leader_heading)) * cos
        closing += (speed * sin - leader_speed * math.sin(leader_heading)) * sin
    braking = 2 * math.sqrt(p.acceleration * p.deceleration)
    return p.jam_distance + speed * p.time_headway + speed * closing / braking


@compiled
def free_acceleration(
    b: int, vehicle: int, exponent: float, scene: Scene, p: IdmMobilParameters
) -> float:
    """Acceleration towards the target speed on an empty road, m/s2."""
    target = min(max(scene.target_speed[b, vehicle], 0.0), scene.constants.speed_limit)
    share = max(scene.speed[b, vehicle], 0.0) / abs(not_zero(target))
    return p.acceleration * (1 - share**exponent)


@compiled
def interaction(b: int, vehicle: int, leader: int, scene: Scene, p: IdmMobilParameters) -> float:
    """Deceleration on account of a leader, m/s2; 0 without one."""
    if leader < 0:
        return 0.0
    gap = not_zero(scene.x[b, leader] - scene.x[b, vehicle])
    return p.acceleration * (desired_gap(b, vehicle, leader, scene, p) / gap) ** 2


@compiled
def idm_acceleration(
    b: int, vehicle: int, leader: int, exponent: float, scene: Scene, p: IdmMobilParameters
) -> float:
    """IDM acceleration, m/s2, Treiber et al. 2000 eq. 3 [`IDMVehicle.acceleration`].

    0 without a vehicle; `exponent` is that of the driver who does the reckoning.
    """
    if vehicle < 0:
        return 0.0
    free = free_acceleration(b, vehicle, exponent, scene, p)
    return free - interaction(b, vehicle, leader, scene, p)
