"""Distances between two vehicles of their own lengths and widths, and how critical they are.

Each is written once: compiled code calls it with numbers, other code with arrays, and metrics with
columns. Where a formula needs a case, metrics have a second body; a test holds both equal.
"""

from typing import Any

import numpy as np
from numba.extending import register_jitable

from charms_bench.foundation.compiled import inlined

SLOWEST_MPS = 1.0
"""Of the speed in a time headway."""


@register_jitable
def gap_to(distance: Any, length: Any, ahead_length: Any) -> Any:
    """From a vehicle's front to the rear of one whose centre is a distance ahead, m.

    It is negative if they overlap.
    """
    return distance - (length + ahead_length) / 2


@register_jitable
def side_gap(y: Any, other_y: Any, width: Any, other_width: Any) -> Any:
    """Between the sides of two vehicles, m; negative if they overlap across the road."""
    return abs(other_y - y) - (width + other_width) / 2


@register_jitable
def overhang(length: Any, standard_length: Any) -> Any:
    """How much further a vehicle reaches from its centre than one of the profile's length, m."""
    return (length - standard_length) / 2


@register_jitable
def following_distance(distance: Any, overhang: Any, ahead_overhang: Any) -> Any:
    """The distance to a vehicle ahead as driver models measure it, m, from that of the centres.

    It is the distance between the centres of two vehicles of the profile's length with the same gap
    between their bumpers, because highway-env's jam distance contains one such length.
    """
    return distance - (overhang + ahead_overhang)


@register_jitable
def is_within(gap: Any, speed: Any, time_s: float) -> Any:
    """Whether a gap is covered in less than a time at a speed, forwards.

    At the closing speed, that time is the time to collision, and at a vehicle's own speed, the time
    headway.
    """
    return gap < time_s * speed


@register_jitable
def required_braking(gap: Any, closing: Any) -> Any:
    """The deceleration that just avoids a collision (DRAC), m/s2, if the gap is closing.

    Cooper & Ferguson 1976.
    """
    return closing**2 / (2 * gap)


@register_jitable
def requires_braking(gap: Any, closing: Any, limit_mps2: float) -> Any:
    """Whether `required_braking` is above a limit; without a gap, it is if vehicles close in."""
    return (closing > 0) & (closing**2 > 2 * limit_mps2 * gap)


def time_headway(gap: Any, speed: Any) -> Any:
    """The time in which a vehicle covers a gap, s, at a speed of at least `SLOWEST_MPS`."""
    return gap / np.maximum(speed, SLOWEST_MPS)


def time_to_collision(gap: Any, closing: Any) -> Any:
    """The time until a gap is closed at constant speeds, s; NaN unless it is closing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing > 0, np.divide(gap, closing), np.nan)


@inlined
def overlap(distance: float, speed: float, size: float) -> tuple[float, float]:
    """When a distance that changes with a speed is at most a size either way: from and to."""
    if speed == 0.0:
        return (-np.inf, np.inf) if abs(distance) <= size else (np.inf, -np.inf)
    one, other = (-size - distance) / speed, (size - distance) / speed
    return min(one, other), max(one, other)
