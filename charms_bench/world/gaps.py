"""Distances between two vehicles of their own lengths and widths.

Each is written once: compiled code calls it with numbers, other code with arrays.
"""

from typing import Any

from numba.extending import register_jitable


@register_jitable
def gap_to(x: Any, ahead_x: Any, length: Any, ahead_length: Any) -> Any:
    """From a vehicle's front to the rear of a vehicle ahead, m; negative if they overlap."""
    return ahead_x - x - (length + ahead_length) / 2


@register_jitable
def side_gap(y: Any, other_y: Any, width: Any, other_width: Any) -> Any:
    """Between the sides of two vehicles, m; negative if they overlap across the road."""
    return abs(other_y - y) - (width + other_width) / 2


@register_jitable
def overhang(length: Any, standard_length: Any) -> Any:
    """How much further a vehicle reaches from its centre than one of the profile's length, m."""
    return (length - standard_length) / 2


@register_jitable
def following_distance(x: Any, ahead_x: Any, overhang: Any, ahead_overhang: Any) -> Any:
    """The distance to a vehicle ahead as driver models measure it, m.

    It is the distance between the centres of two vehicles of the profile's length with the same gap
    between their bumpers, because highway-env's jam distance contains one such length.
    """
    return ahead_x - x - (overhang + ahead_overhang)
