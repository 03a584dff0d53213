"""Responsibility-sensitive safety (RSS): who drives too close to a vehicle ahead.

Distances are those of Shalev-Shwartz, Shammah & Shashua 2017 (arXiv 1708.06374), definitions 1 and
6, as intel/ad-rss-lib computes them. A situation is dangerous if both the gap along the road and
the gap across it are too small. Every vehicle is judged with the response time of the vehicle
under control, because each is judged as one driver among others.
"""

from typing import Any

from charms_bench.foundation.compiled import compiled, index, inlined
from charms_bench.world.gaps import gap_to, side_gap
from charms_bench.world.scene import Ints, Scene

# ad-rss-lib, Appendix-ParameterDiscussion.md.
RESPONSE_S = 1.0
ACCELERATION_MPS2 = 3.5
"""The vehicle behind accelerates at most this much before it responds."""
BRAKING_MPS2 = 4.0
"""It then brakes at least this much."""
HARDEST_BRAKING_MPS2 = 8.0
"""The vehicle ahead brakes at most this much."""
LATERAL_ACCELERATION_MPS2 = 0.2
LATERAL_BRAKING_MPS2 = 0.8
LATERAL_MARGIN_M = 0.1


@inlined
def safe_distance(behind_mps: float, ahead_mps: float) -> float:
    """The least safe gap between bumpers, m, for two speeds along the road."""
    after = behind_mps + RESPONSE_S * ACCELERATION_MPS2
    driven = behind_mps * RESPONSE_S + ACCELERATION_MPS2 * RESPONSE_S**2 / 2
    stopping = after**2 / (2 * BRAKING_MPS2) - ahead_mps**2 / (2 * HARDEST_BRAKING_MPS2)
    return max(driven + stopping, 0.0)


@inlined
def safe_side_distance(one_mps: float, other_mps: float) -> float:
    """The least safe gap between sides, m, for the speeds of two vehicles towards each other."""
    return LATERAL_MARGIN_M + max(_drift(one_mps) + _drift(other_mps), 0.0)


@inlined
def _drift(towards_mps: float) -> float:
    """How far a vehicle moves aside until it no longer moves towards the other, m."""
    after = towards_mps + RESPONSE_S * LATERAL_ACCELERATION_MPS2
    driven = towards_mps * RESPONSE_S + LATERAL_ACCELERATION_MPS2 * RESPONSE_S**2 / 2
    return driven + max(after, 0.0) ** 2 / (2 * LATERAL_BRAKING_MPS2)


@compiled
def note_rss(scene: Scene, scenes: Ints, interval_s: float, state: Any, sums: Any) -> None:
    """Adds the time in danger from the nearest vehicles ahead on the own and adjacent lanes."""
    c, x, y, speed, lanes = scene.constants, scene.x, scene.y, scene.speed, scene.lane
    direction_x, direction_y, leaders = scene.direction_x, scene.direction_y, scene.leaders
    length, width = scene.length, scene.width
    for row in scenes:
        b = index(row)
        for i in range(x.shape[1]):
            own = state[b, i]
            if own.lost:
                continue
            forward, aside = speed[b, i] * direction_x[b, i], speed[b, i] * direction_y[b, i]
            is_too_close = False
            for on in range(max(lanes[b, i] - 1, 0), min(lanes[b, i] + 2, c.lanes)):
                found = leaders[b, i, on]
                j = max(found, 0)
                gap = gap_to(x[b, i], x[b, j], length[b, i], length[b, j])
                to_the_right = 1.0 if y[b, j] > y[b, i] else -1.0
                aside_m = side_gap(y[b, i], y[b, j], width[b, i], width[b, j])
                approach = -to_the_right * speed[b, j] * direction_y[b, j]
                # No branches: what is true of a pair cannot be predicted, which costs more.
                is_dangerous = (
                    (found >= 0)
                    & (gap < safe_distance(forward, speed[b, j] * direction_x[b, j]))
                    & (aside_m < safe_side_distance(to_the_right * aside, approach))
                )
                is_too_close |= is_dangerous
                state[b, j].is_pressed |= is_dangerous
            sums[b, own.driver].rss_by_s += interval_s * is_too_close
        for i in range(x.shape[1]):
            own = state[b, i]
            sums[b, own.driver].rss_to_s += interval_s * (own.is_pressed & (not own.lost))
            own.is_pressed = False
