"""The kinematic bicycle model and highway-env's controllers as formulas of numbers, for every road.

They are woven into their callers; see `world.idm_mobil`.
"""

import math
from typing import Any

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, woven


@woven
def towards_speed(speed: float, target_speed: float, tau_s: float) -> float:
    """The acceleration towards a target speed, m/s2 [`ControlledVehicle.speed_control`]."""
    return (1 / tau_s) * (target_speed - speed)


@woven
def limited(acceleration: float, speed: float, speed_min: float, speed_max: float) -> Any:
    """The acceleration of a vehicle whose speed has limits, m/s2 [`Vehicle.clip_actions`]."""
    slowed = min(acceleration, 1.0 * (speed_max - speed)) if speed > speed_max else acceleration
    return max(slowed, 1.0 * (speed_min - speed)) if speed < speed_min else slowed


@woven
def towards_centre(lateral: float, speed: float, tau_s: float) -> Any:
    """The angle to a lane that leads to its centre [`ControlledVehicle.steering_control`].

    `lateral` is the position beside the centre, m; `speed` is `not_zero`, as in the next function.
    """
    angle = maths.asin(clip(-(1 / tau_s) * lateral / speed, -1.0, 1.0))
    return clip(angle, -math.pi / 4, math.pi / 4)


@woven
def slip_to_turn(angle: float, speed: float, half_length: float, tau_s: float) -> float:
    """The slip angle with which a vehicle turns by an angle [`steering_control`]."""
    heading_rate = (1 / tau_s) * angle
    return maths.asin(clip(half_length / speed * heading_rate, -1.0, 1.0))


@woven
def steering_of(slip_tangent: float) -> float:
    """The steering angle, given the tangent of the slip angle [`steering_control`].

    Loops compute tangents first: two elementary functions in one loop are slower.
    """
    return maths.atan(2 * slip_tangent)


@woven
def slip_of(steering_tangent: float) -> float:
    """The slip angle of the centre, given the tangent of the steering angle [`Vehicle.step`]."""
    return maths.atan(1 / 2 * steering_tangent)


@woven
def displacement(heading: float, slip: float, speed: float, dt: float) -> tuple[float, float]:
    """How far a vehicle moves along x and y in a step, m [`Vehicle.step`]."""
    sine, cosine = maths.sin_cos(heading + slip)
    return speed * cosine * dt, speed * sine * dt


@woven
def turn_of(slip: float, speed: float, half_length: float, dt: float) -> float:
    """By what angle a vehicle turns in a step [`Vehicle.step`]."""
    return speed * maths.sin(slip) / half_length * dt
