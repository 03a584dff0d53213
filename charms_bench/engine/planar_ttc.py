"""Time to collision in the plane: when an ego's footprint would touch that of another vehicle.

Footprints are rectangles along the vehicles' headings. If all vehicles kept their velocities and
their headings, two rectangles would touch as soon as their shadows overlap on each of the four axes
that are parallel to a side (separating axes). So a vehicle beside the ego or behind it counts like
the leader, as in FHWA's Surrogate Safety Assessment Model (Gettman et al. 2008, FHWA-HRT-08-051);
that model moves vehicles along their later paths, which are not known here.
"""

import numpy as np

from charms_bench.foundation.compiled import compiled, compiled_of_scenes, index, inlined
from charms_bench.world.scene import Floats, Ints, Scene

HORIZON_S = 10.0
"""A longer time is not recorded: vehicles do not keep their velocities for so long."""


@compiled_of_scenes
def planar_ttc(scene: Scene, scenes: Ints) -> Floats:
    """The least time (S,) until the ego of each scene touches a vehicle, s; infinite if none does.

    Times above `HORIZON_S` count as infinite; a vehicle that the ego overlaps gives 0.
    """
    times = np.empty(scenes.size)
    x, y, speed, egos = scene.x, scene.y, scene.speed, scene.ego
    direction_x, direction_y = scene.direction_x, scene.direction_y
    lengths, widths = scene.length, scene.width
    for s in range(scenes.size):
        b = index(scenes[s])
        ego = index(egos[b])
        own_x, own_y = x[b, ego], y[b, ego]
        cos, sin = direction_x[b, ego], direction_y[b, ego]
        length, width = lengths[b, ego], widths[b, ego]
        own_ahead, own_aside = speed[b, ego] * cos, speed[b, ego] * sin
        reach_x = (length * (1 + abs(cos)) + width * abs(sin)) / 2
        reach_y = (width * (1 + abs(cos)) + length * abs(sin)) / 2
        least = HORIZON_S
        found = False
        for i in range(x.shape[1]):
            if i == ego:
                continue
            other_cos, other_sin = direction_x[b, i], direction_y[b, i]
            dx, dy = x[b, i] - own_x, y[b, i] - own_y
            ahead = speed[b, i] * other_cos - own_ahead
            aside = speed[b, i] * other_sin - own_aside
            # Upright boxes around both are larger, so nearly all vehicles are rejected by theirs.
            turned = abs(other_sin)
            longer, wider = lengths[b, i] - length, widths[b, i] - width
            gap_x = abs(dx) - reach_x - widths[b, i] * turned / 2 - longer / 2
            gap_y = abs(dy) - reach_y - lengths[b, i] * turned / 2 - wider / 2
            closing_x = -ahead if dx > 0 else ahead
            closing_y = -aside if dy > 0 else aside
            # Without branches: where vehicles are cannot be predicted.
            if (gap_x > max(closing_x * least, 0.0)) | (gap_y > max(closing_y * least, 0.0)):
                continue
            sizes = length, width, lengths[b, i], widths[b, i]
            time = time_to_touch(dx, dy, ahead, aside, cos, sin, other_cos, other_sin, *sizes)
            if time <= least:
                least, found = time, True
        times[s] = least if found else np.inf
    return times


@compiled
def time_to_touch(
    dx: float,
    dy: float,
    ahead: float,
    aside: float,
    cos: float,
    sin: float,
    other_cos: float,
    other_sin: float,
    length: float,
    width: float,
    other_length: float,
    other_width: float,
) -> float:
    """When two rectangles touch, s; infinite if they never do.

    Args:
        dx, dy: Position of the other rectangle's centre from the first one's, m.
        ahead, aside: Its velocity relative to the first one's, m/s.
        cos, sin: Direction of the first one's heading.
        other_cos, other_sin: Direction of the other one's heading.
        length, width: Of the first one, m.
        other_length, other_width: Of the other one, m.
    """
    parallel = abs(cos * other_cos + sin * other_sin)
    turned = abs(cos * other_sin - sin * other_cos)
    own, other = (cos, sin, length, width), (other_cos, other_sin, other_length, other_width)
    begin, end = 0.0, np.inf
    for (axis_x, axis_y, long, wide), (_, _, far_long, far_wide) in ((own, other), (other, own)):
        along = (far_long * (1 + parallel) + (long - far_long) + far_wide * turned) / 2
        across = (far_wide * (1 + parallel) + (wide - far_wide) + far_long * turned) / 2
        one, until = overlap(dx * axis_x + dy * axis_y, ahead * axis_x + aside * axis_y, along)
        begin, end = max(begin, one), min(end, until)
        one, until = overlap(dy * axis_x - dx * axis_y, aside * axis_x - ahead * axis_y, across)
        begin, end = max(begin, one), min(end, until)
    return begin if begin <= end else np.inf


@inlined
def overlap(distance: float, speed: float, size: float) -> tuple[float, float]:
    """When a distance that changes with a speed is at most a size either way: from and to."""
    if speed == 0.0:
        return (-np.inf, np.inf) if abs(distance) <= size else (np.inf, -np.inf)
    one, other = (-size - distance) / speed, (size - distance) / speed
    return min(one, other), max(one, other)
