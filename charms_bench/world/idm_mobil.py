"""The formulas of IDM (Treiber et al. 2000) and MOBIL (Kesting et al. 2007) in highway-env's form.

They take numbers. The caller finds the neighbours and the distances to them: `charms_baselines.idm`
on the straight road, `roads.driving` on highway-env's networks. The parameters `p` are
`IdmMobilParameters`, or a row of a table with fields of the same names.

Most are woven into their callers, because a loop that calls a function is unrolled before it can be
vectorised if its body looks short.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from numba.extending import register_jitable

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, not_zero, woven


class Velocity(NamedTuple):
    """The velocity of a vehicle: a speed, and the direction of the heading."""

    speed: float
    direction_x: float
    direction_y: float


@register_jitable
def equilibrium_gap(speed: Any, p: Any) -> Any:
    """Desired gap to a leader of the same speed, centre to centre, m."""
    return p.jam_distance_m + speed * p.time_headway_s


@woven
def desired_gap(speed: float, closing: float, p: Any) -> float:
    """Desired gap to a leader, centre to centre, m [`IDMVehicle.desired_gap`]."""
    braking = 2 * math.sqrt(p.acceleration_mps2 * p.deceleration_mps2)
    return float(max(equilibrium_gap(speed, p) + speed * closing / braking, p.least_gap_m))


@woven
def closing_speed(vehicle: Any, leader: Any) -> float:
    """Speed at which a vehicle approaches its leader, along its own heading, m/s.

    Each is a `Velocity`, or anything with its fields.
    """
    ahead = vehicle.speed * vehicle.direction_x - leader.speed * leader.direction_x
    aside = vehicle.speed * vehicle.direction_y - leader.speed * leader.direction_y
    return float(ahead * vehicle.direction_x + aside * vehicle.direction_y)


@woven
def speed_ratio(speed: float, target_speed: float, speed_limit: float) -> float:
    """The speed divided by the target speed, as IDM sees them."""
    return max(speed, 0.0) / abs(not_zero(clip(target_speed, 0.0, speed_limit)))


@woven
def free_acceleration(ratio: float, exponent: float, most_mps2: float) -> float:
    """IDM acceleration on a free road, m/s2, eq. 3, first part; `ratio` is `speed_ratio`."""
    return most_mps2 * (1 - maths.power(ratio, exponent))


@woven
def interaction(wanted_m: float, distance_m: float, most_mps2: float) -> float:
    """IDM deceleration behind a leader, m/s2, eq. 3, second part; `wanted_m` is `desired_gap`."""
    crowding = wanted_m / not_zero(distance_m)
    return most_mps2 * (crowding * crowding)


@woven
def imposes_braking(acceleration: float, p: Any) -> bool:
    """Whether a lane change would have a vehicle brake too hard (MOBIL, eq. 2)."""
    return bool(acceleration < -p.imposed_braking_mps2)


@woven
def mobil(
    expected: Callable[[Any, Any, Any], float],
    driver: Any,
    gain: float,
    own: Any,
    behind: tuple[Any, Any],
    ahead: tuple[Any, Any],
    p: Any,
) -> bool:
    """Whether to change lanes (MOBIL, eqs. 2 and 3) [`IDMVehicle.mobil`, without a route].

    Args:
        expected: `expected(driver, vehicle, leader)` is the acceleration that the driver expects of
            a vehicle behind a leader; 0 if there is no such vehicle.
        driver: The driver of the vehicle `own`, as `expected` knows it.
        gain: How much more `own` would accelerate on the new lane.
        own: The vehicle, as `expected` knows it; so are the next.
        behind: The followers of `own` on the present and on the new lane.
        ahead: The leaders likewise.
        p: The driver's parameters.
    """
    if p.politeness == 0 and not gain >= p.lane_change_gain_mps2:
        return False  # before the costly part; the result is the same
    after = expected(driver, behind[1], own)
    if imposes_braking(after, p):
        return False
    if p.politeness > 0:
        others = after - expected(driver, behind[1], ahead[1])
        others = others + expected(driver, behind[0], ahead[0])
        gain += p.politeness * (others - expected(driver, behind[0], own))
    return bool(gain >= p.lane_change_gain_mps2)
