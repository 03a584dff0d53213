"""The goal states of planning problems [`GoalRegion.is_reached` of commonroad-io].

A goal state is met by an ego whose centre is in one of its areas, at a time, with a speed and with
a heading in its intervals. What a goal state does not say can be anything.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.maps.commonroad_scene import Problem
from charms_bench.roads.scenes import Scenes

_ROUNDING = 1e-6
"""Frames; times of steps are sums of intervals."""


class GoalStates(NamedTuple):
    """The G goal states of M planning problems, and their A areas of P points."""

    ends: Ints
    """(M,) the number of states up to each problem."""
    first: Floats
    """(M,) the frame at which it starts."""
    intervals: Floats
    """(G, 3, 2) from which frame, speed and heading to which."""
    area_ends: Ints
    """(G,) the number of areas up to each state; a state without areas is met anywhere."""
    point_ends: Ints
    """(A,) the number of points up to each area."""
    points: Floats
    """(P, 2) corners, or the middle of a circle, m."""
    radii: Floats
    """(A,) m; 0 for a polygon."""


def goal_states(problems: Sequence[Problem]) -> GoalStates:
    """The goal states of some planning problems."""
    states = [state for each in problems for state in each.goals]
    areas = [area for state in states for area in state.areas]
    return GoalStates(
        np.cumsum([len(each.goals) for each in problems], dtype=np.int64),
        np.array([each.frame for each in problems], dtype=np.float64),
        np.array([(s.frames, s.speeds, s.headings) for s in states], np.float64).reshape(-1, 3, 2),
        np.cumsum([len(state.areas) for state in states], dtype=np.int64),
        np.cumsum([len(area.corners) for area in areas], dtype=np.int64),
        np.array([p for area in areas for p in area.corners], np.float64).reshape(-1, 2),
        np.array([area.radius for area in areas], dtype=np.float64),
    )


@compiled_of_scenes
def have_met(scenes: Scenes, numbers: Ints, goals: GoalStates, rate_hz: float) -> Bools:
    """(B,) whether the egos meet goal states of the problems `numbers` (B,) now."""
    found = np.zeros(numbers.size, dtype=np.bool_)
    for b in range(found.size):
        ego, m = scenes.vehicles[b, 0], numbers[b]
        frame = goals.first[m] + scenes.time[b] * rate_hz
        for g in range(goals.ends[m - 1] if m > 0 else 0, goals.ends[m]):
            times, speeds, headings = goals.intervals[g]
            is_met = times[0] - _ROUNDING <= frame <= times[1] + _ROUNDING
            is_met = is_met and speeds[0] <= ego.speed <= speeds[1]
            if is_met and headings[1] < np.inf:
                turned = (ego.heading - headings[0]) % (2 * np.pi)
                is_met = turned <= headings[1] - headings[0]
            begin = goals.area_ends[g - 1] if g > 0 else 0
            is_inside = begin == goals.area_ends[g]
            for a in range(begin, goals.area_ends[g]):
                is_inside = is_inside or is_in_area(goals, a, ego.x, ego.y)
            found[b] = found[b] or (is_met and is_inside)
    return found


@compiled
def is_in_area(goals: GoalStates, a: int, x: float, y: float) -> bool:
    """Whether a point is in an area: in its circle, or crosses its sides an odd number of times."""
    begin, end = goals.point_ends[a - 1] if a > 0 else 0, goals.point_ends[a]
    if goals.radii[a] > 0:
        dx, dy = x - goals.points[begin, 0], y - goals.points[begin, 1]
        return bool(dx * dx + dy * dy <= goals.radii[a] ** 2)
    is_inside = False
    for k in range(begin, end):
        one, other = goals.points[k], goals.points[k - 1 if k > begin else end - 1]
        if (one[1] > y) != (other[1] > y):
            across = one[0] + (y - one[1]) / (other[1] - one[1]) * (other[0] - one[0])
            if x < across:
                is_inside = not is_inside
    return is_inside
