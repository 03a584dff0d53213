"""The Intelligent Driver Model (Treiber et al. 2000) as highway-env computes it, compiled."""

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
def desired_gap(speed: float, closing_speed: float, p: IdmMobilParameters) -> float:
    """Gap wanted to a leader, centre to centre, m [`IDMVehicle.desired_gap`]."""
    braking = 2 * math.sqrt(p.acceleration * p.deceleration)
    return p.jam_distance + speed * p.time_headway + speed * closing_speed / braking


@compiled
def idm_acceleration(
    speed: float,
    wanted_speed: float,
    gap: float,
    closing_speed: float,
    exponent: float,
    p: IdmMobilParameters,
) -> float:
    """IDM acceleration, m/s2, Treiber et al. 2000 eq. 3 [`IDMVehicle.acceleration`].

    `gap` is centre to centre, and infinite without a leader.
    """
    free = p.acceleration * (1 - (max(speed, 0.0) / abs(not_zero(wanted_speed))) ** exponent)
    crowding = desired_gap(speed, closing_speed, p) / not_zero(gap)
    return free - p.acceleration * (crowding * crowding)


@compiled
def closing_speed(
    speed: float, heading: float, leader_speed: float, leader_heading: float
) -> float:
    """Speed at which a vehicle nears its leader, along its own heading, m/s."""
    if heading == 0.0 and leader_heading == 0.0:
        return speed - leader_speed
    cos, sin = math.cos(heading), math.sin(heading)
    ahead = speed * cos - leader_speed * math.cos(leader_heading)
    aside = speed * sin - leader_speed * math.sin(leader_heading)
    return ahead * cos + aside * sin


@compiled
def following(
    b: int, i: int, leader: int, exponent: float, scene: Scene, p: IdmMobilParameters
) -> float:
    """IDM acceleration of vehicle i of scene b behind a leader, m/s2.

    -1 is no vehicle, as in the neighbour tables; no vehicle accelerates by 0. `exponent` is that
    of the driver who does the reckoning.
    """
    if i < 0:
        return 0.0
    speed = scene.speed[b, i]
    gap, closing = math.inf, 0.0
    if leader >= 0:
        gap = scene.x[b, leader] - scene.x[b, i]
        closing = closing_speed(
            speed, scene.heading[b, i], scene.speed[b, leader], scene.heading[b, leader]
        )
    wanted = min(max(scene.target_speed[b, i], 0.0), scene.constants.speed_limit)
    return idm_acceleration(speed, wanted, gap, closing, exponent, p)
