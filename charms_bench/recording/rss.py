"""Responsibility-sensitive safety (RSS): who drives too close to a vehicle ahead.

Distances are those of Shalev-Shwartz, Shammah & Shashua 2017 (arXiv 1708.06374), definitions 1 and
6, as intel/ad-rss-lib computes them. A situation is dangerous if both the gap along the road and
the gap across it are too small. Every vehicle is judged with the response time of the vehicle
under control, because each is judged as one driver among others.
"""

from typing import Any

from charms_bench.foundation.compiled import index, inlined
from charms_bench.recording.primitives import Some, distance_to
from charms_bench.world.gaps import gap_to, side_gap
from charms_bench.world.road import Straight
from charms_bench.world.scene import Ints

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


@inlined
def note_rss(
    road: Straight,
    some: Some,
    now: Any,
    decision: int,
    interval_s: float,
    driver: Ints,
    state: Any,
    sums: Any,
) -> None:
    """Adds the time in danger from the nearest vehicles ahead on the own and adjacent lanes."""
    for i in range(some[0], some[1]):
        own = now[i]
        if own.lost:
            continue
        forward, aside = own.speed * own.direction_x, own.speed * own.direction_y
        is_too_close = False
        for found in (own.left_leader, own.leader, own.right_leader):
            if found < 0:
                continue
            j = index(found)
            other = now[j]
            # Across the road first: nearly all vehicles on adjacent lanes are far enough aside.
            to_the_right = 1.0 if other.y > own.y else -1.0
            aside_m = side_gap(own.y, other.y, own.width, other.width)
            approach = -to_the_right * other.speed * other.direction_y
            if aside_m >= safe_side_distance(to_the_right * aside, approach):
                continue
            gap = gap_to(distance_to(road, own, other), own.length, other.length)
            if gap < safe_distance(forward, other.speed * other.direction_x):
                is_too_close = True
                if state[j].pressed != decision and not other.lost:
                    sums[driver[j]].rss_to_s += interval_s
                state[j].pressed = decision
        if is_too_close:
            sums[driver[i]].rss_by_s += interval_s
