"""Time to collision in the plane: when an ego's footprint would touch that of another vehicle.

Footprints are rectangles along the vehicles' headings. If all vehicles kept their velocities and
their headings, two rectangles would touch as soon as their shadows overlap on each of the four axes
that are parallel to a side (separating axes). So a vehicle beside the ego or behind it counts like
the leader, as in FHWA's Surrogate Safety Assessment Model (Gettman et al. 2008, FHWA-HRT-08-051);
that model moves vehicles along their later paths, which are not known here.
"""

from typing import Any

import numpy as np

from charms_bench.foundation.compiled import compiled
from charms_bench.world.gaps import overlap

HORIZON_S = 10.0
"""A longer time is not recorded: vehicles do not keep their velocities for so long."""


@compiled
def planar_ttc(now: Any, ego: int) -> float:
    """The least time until a vehicle touches another one, s; infinite if it touches none.

    Times above `HORIZON_S` count as infinite; a vehicle that overlaps another one gives 0. `now`
    are the (N,) vehicles of a frame, see `primitives.VEHICLE`.
    """
    own = now[ego]
    own_x, own_y, length, width = own.x, own.y, own.length, own.width
    cos, sin = own.direction_x, own.direction_y
    own_ahead, own_aside = own.speed * cos, own.speed * sin
    reach_x = (length * (1 + abs(cos)) + width * abs(sin)) / 2
    reach_y = (width * (1 + abs(cos)) + length * abs(sin)) / 2
    least = HORIZON_S
    found = False
    for i in range(now.size):
        if i == ego:
            continue
        other = now[i]
        other_cos, other_sin = other.direction_x, other.direction_y
        dx, dy = other.x - own_x, other.y - own_y
        ahead = other.speed * other_cos - own_ahead
        aside = other.speed * other_sin - own_aside
        # Upright boxes around both are larger, so nearly all vehicles are rejected by theirs.
        turned = abs(other_sin)
        longer, wider = other.length - length, other.width - width
        gap_x = abs(dx) - reach_x - other.width * turned / 2 - longer / 2
        gap_y = abs(dy) - reach_y - other.length * turned / 2 - wider / 2
        closing_x = -ahead if dx > 0 else ahead
        closing_y = -aside if dy > 0 else aside
        # Without branches: where vehicles are cannot be predicted.
        if (gap_x > max(closing_x * least, 0.0)) | (gap_y > max(closing_y * least, 0.0)):
            continue
        time = time_to_touch(own, other)
        if time <= least:
            least, found = time, True
    return least if found else np.inf


@compiled
def time_to_touch(own: Any, other: Any) -> float:
    """When the rectangles of two vehicles touch, s; infinite if they never do."""
    dx, dy = other.x - own.x, other.y - own.y
    ahead = other.speed * other.direction_x - own.speed * own.direction_x
    aside = other.speed * other.direction_y - own.speed * own.direction_y
    parallel = abs(own.direction_x * other.direction_x + own.direction_y * other.direction_y)
    turned = abs(own.direction_x * other.direction_y - own.direction_y * other.direction_x)
    begin, end = 0.0, np.inf
    for one, far in ((own, other), (other, own)):
        along = (far.length * (1 + parallel) + (one.length - far.length) + far.width * turned) / 2
        across = (far.width * (1 + parallel) + (one.width - far.width) + far.length * turned) / 2
        cos, sin = one.direction_x, one.direction_y
        for distance, speed, reach in (
            (dx * cos + dy * sin, ahead * cos + aside * sin, along),
            (dy * cos - dx * sin, aside * cos - ahead * sin, across),
        ):
            since, until = overlap(distance, speed, reach)
            begin, end = max(begin, since), min(end, until)
    return begin if begin <= end else np.inf
