"""Lane changes, those given up, and the braking that they impose on the new follower.

The new follower is the follower on the new lane at the first decision there, and stays so for 2 s,
whichever vehicle follows later.

A lane change is complete when the nearest lane changes. It is given up when another lane becomes
the target lane before that. Another vehicle took the gap if it came to the wanted lane meanwhile,
or is still steering to it, and is the next vehicle ahead or behind among those on that lane or
steering to it, at most 50 m away. Fig. 4 of the paper shows such a case. The lane change must have
been under way at two successive decisions, because a driver model can take one back at once.
"""

from typing import Any

import numpy as np
from numba.extending import register_jitable

from charms_bench.foundation.compiled import compiled, inlined
from charms_bench.recording.primitives import NOBODY, Some, distance_to
from charms_bench.world.road import Straight
from charms_bench.world.scene import Ints
from charms_bench.world.thresholds import HARD_BRAKING_MPS2

TAKEN_RANGE_M = 50.0
ATTEMPT_DECISIONS = 2
IMPOSED_S = 2.0
"""For this long after a lane change, the new follower's braking is attributed to it."""


def imposed_decisions(interval_s: float) -> int:
    """At how many decisions braking is attributed to a lane change; the first is its own."""
    return max(1, round(IMPOSED_S / interval_s))


@register_jitable
def is_given_up(lane: Any, wanted: Any, next_lane: Any, next_target: Any) -> Any:
    """Whether a lane change is given up between two decisions; numbers, arrays or expressions."""
    return (wanted != lane) & (next_lane == lane) & (next_target != wanted)


@inlined
def note_lane_changes(
    road: Straight,
    some: Some,
    now: Any,
    before: Any,
    decision: int,
    driver: Ints,
    new_followers: Ints,
    sums: Any,
) -> None:
    """Adds the lane changes, the given-up ones and the hard braking of a decision interval.

    `new_followers` [N, W] holds the new followers of the lane changes at the last W decisions,
    until they brake hard.
    """
    window = new_followers.shape[1]
    latest = decision % window
    for i in range(some[0], some[1]):
        own, was = now[i], before[i]
        has_same_lanes = (own.lane == was.lane) & (own.target_lane == was.target_lane)
        if own.lost or (has_same_lanes & (decision > own.lane_since + window)):
            continue
        mine, wanted = sums[driver[i]], was.target_lane
        new_followers[i, latest] = NOBODY
        if own.lane != was.lane:
            mine.lane_changes += 1
            new_followers[i, latest] = own.follower
        elif is_given_up(was.lane, wanted, own.lane, own.target_lane):
            mine.abandoned += 1
            if decision - was.target_since >= ATTEMPT_DECISIONS:
                taker = taker_of(road, i, wanted, was.target_since, now)
                if taker >= 0:
                    mine.gaps_lost += 1
                    sums[driver[taker]].gaps_taken += 1
        if decision < own.lane_since + window:
            for k in range(window):
                j = new_followers[i, k]
                if j >= 0 and not now[j].crashed and now[j].acceleration < -HARD_BRAKING_MPS2:
                    mine.hard_braking_by += 1
                    sums[driver[j]].hard_braking_to += 1
                    new_followers[i, k] = NOBODY


@compiled
def taker_of(road: Straight, i: int, wanted: int, began: int, now: Any) -> int:
    """The vehicle that took the gap to which a vehicle wanted to change, or -1."""
    ahead = behind = -1
    least_ahead = least_behind = np.inf
    for j in range(now.size):
        if j == i or wanted not in (now[j].lane, now[j].target_lane):
            continue
        distance = distance_to(road, now[i], now[j])
        if 0 <= distance < least_ahead:
            ahead, least_ahead = j, distance
        elif distance < 0 and -distance < least_behind:
            behind, least_behind = j, -distance
    taker, least = -1, TAKEN_RANGE_M
    for j, distance in ((ahead, least_ahead), (behind, least_behind)):
        if j >= 0 and distance <= least and now[j].target_lane == wanted:
            came = now[j].lane != wanted or now[j].lane_since > began
            if came and not now[j].lost:
                taker, least = j, distance
    return taker
