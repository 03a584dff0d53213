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

from charms_bench.foundation.compiled import compiled, index, inlined
from charms_bench.world.scene import Ints, Scene
from charms_bench.world.thresholds import HARD_BRAKING_MPS2

TAKEN_RANGE_M = 50.0
ATTEMPT_DECISIONS = 2
IMPOSED_S = 2.0
"""For this long after a lane change, the new follower's braking is attributed to it."""
NOBODY = -1


@inlined
def imposed_decisions(interval_s: float) -> int:
    """At how many decisions braking is attributed to a lane change; the first is its own."""
    return max(1, round(IMPOSED_S / interval_s))


@compiled
def note_lane_changes(
    scene: Scene, scenes: Ints, steps: Ints, state: Any, new_followers: Ints, sums: Any
) -> None:
    """Adds the lane changes, the given-up ones and the hard braking of a decision interval.

    `new_followers` [B, N, W] holds the new followers of the lane changes at the last W decisions,
    until they brake hard.
    """
    lanes, target_lane, crashed = scene.lane, scene.target_lane, scene.crashed
    followers, acceleration, vehicles = scene.followers, scene.acceleration, scene.x.shape[1]
    window = new_followers.shape[2]
    for row in scenes:
        b = index(row)
        step = steps[b]
        for i in range(vehicles):
            if lanes[b, i] != state[b, i].lane:
                state[b, i].changed = step
        for i in range(vehicles):
            own = state[b, i]
            lane, target, wanted = lanes[b, i], target_lane[b, i], own.target_lane
            if not own.lost:
                mine = sums[b, own.driver]
                new_followers[b, i, step % window] = NOBODY
                if own.changed == step:
                    mine.lane_changes += 1
                    own.imposes_until = step + window - 1
                    new_followers[b, i, step % window] = followers[b, i, lane]
                elif wanted != own.lane and wanted != target:
                    mine.abandoned += 1
                    taker = -1
                    if step - own.began >= ATTEMPT_DECISIONS:
                        taker = taker_of(b, i, scene, state)
                    if taker >= 0:
                        mine.gaps_lost += 1
                        sums[b, state[b, taker].driver].gaps_taken += 1
                if step <= own.imposes_until:
                    for k in range(window):
                        j = new_followers[b, i, k]
                        if j >= 0 and not crashed[b, j] and acceleration[b, j] < -HARD_BRAKING_MPS2:
                            mine.hard_braking_by += 1
                            sums[b, state[b, j].driver].hard_braking_to += 1
                            new_followers[b, i, k] = NOBODY
            if target != wanted:
                own.began = step


@compiled
def taker_of(b: int, i: int, scene: Scene, state: Any) -> int:
    """The vehicle that took the gap to which a vehicle wanted to change, or -1."""
    x, lanes, target_lane = scene.x, scene.lane, scene.target_lane
    wanted, began = np.int64(state[b, i].target_lane), state[b, i].began
    ahead = behind = -1
    least_ahead = least_behind = np.inf
    for j in range(x.shape[1]):
        if j == i or wanted not in (lanes[b, j], target_lane[b, j]):
            continue
        distance = x[b, j] - x[b, i]
        if 0 <= distance < least_ahead:
            ahead, least_ahead = j, distance
        elif distance < 0 and -distance < least_behind:
            behind, least_behind = j, -distance
    taker, least = -1, TAKEN_RANGE_M
    for j, distance in ((ahead, least_ahead), (behind, least_behind)):
        if j >= 0 and distance <= least and target_lane[b, j] == wanted:
            came = lanes[b, j] != wanted or state[b, j].changed > began
            if came and not state[b, j].lost:
                taker, least = j, distance
    return taker
