"""Conflicts and near misses between a vehicle and its leader, and which of the two began them.

In a conflict, the bumper-to-bumper TTC is below 1.5 s (Gettman & Head 2003). A near miss is a TTC
below 1.5 s or a DRAC above 3.35 m/s2 (Archer 2005) that ends without a collision. Either ends when
both measures are within their limits again, or when the vehicle gets another leader.

The vehicle whose manoeuvre came last began it: the one that entered the other's lane within the
last 2 s, or else the leader if it brakes by more than 2 m/s2, or else the follower, which closes
in.
"""

from typing import Any

from charms_bench.foundation.compiled import compiled, index
from charms_bench.world.gaps import gap_to
from charms_bench.world.scene import Ints, Scene
from charms_bench.world.thresholds import CONFLICT_TTC_S, DRAC_LIMIT_MPS2, HARD_BRAKING_MPS2

MANOEUVRE_S = 2.0
"""A lane change this long ago can have begun a conflict."""
NOBODY = -1


@compiled
def note_conflicts(
    scene: Scene, scenes: Ints, steps: Ints, interval_s: float, state: Any, sums: Any
) -> None:
    """Adds the conflicts that begin and the near misses that end in a decision interval."""
    x, speed, length = scene.x, scene.speed, scene.length
    leaders, lanes, target_lane = scene.leaders, scene.lane, scene.target_lane
    acceleration, active = scene.acceleration, scene.active
    window = round(MANOEUVRE_S / interval_s)
    for row in scenes:
        b = index(row)
        step = steps[b]
        for i in range(x.shape[1]):
            own = state[b, i]
            if own.lost:
                continue
            found = leaders[b, i, lanes[b, i]]
            leader = max(found, 0)
            gap = gap_to(x[b, i], x[b, leader], length[b, i], length[b, leader])
            closing = speed[b, i] - speed[b, leader]
            is_closing = (found >= 0) & (gap > 0) & (closing > 0)
            is_conflict = is_closing & (gap < CONFLICT_TTC_S * closing)
            brakes_hard = is_closing & (closing**2 > 2 * DRAC_LIMIT_MPS2 * gap)
            is_near_miss = is_conflict | brakes_hard
            if not is_near_miss and own.near < 0:
                continue
            if own.near >= 0 and not (is_near_miss and leader == own.near):
                count_near_miss(b, own, state[b, own.near].driver, sums)
                own.near = NOBODY
            if is_near_miss and own.near < 0:
                leader_changed = state[b, leader].changed
                if lanes[b, leader] != lanes[b, i] and target_lane[b, leader] == lanes[b, i]:
                    leader_changed = step  # it is on both lanes, and is entering this one
                if max(own.changed, leader_changed) >= step - window:
                    own.leader_began = leader_changed > own.changed
                else:
                    own.leader_began = acceleration[b, leader] < -HARD_BRAKING_MPS2
                own.near, own.in_conflict = leader, False
            if is_conflict and not own.in_conflict:
                own.in_conflict = True
                other = state[b, leader].driver
                sums[b, other if own.leader_began else own.driver].conflicts_by += 1
                sums[b, own.driver if own.leader_began else other].conflicts_to += 1
            if own.near >= 0 and not active[b]:
                count_near_miss(b, own, state[b, own.near].driver, sums)


@compiled
def count_near_miss(b: int, own: Any, leader: int, sums: Any) -> None:
    """Adds a near miss of a vehicle with a vehicle of the driver `leader`."""
    sums[b, leader if own.leader_began else own.driver].near_misses_by += 1
    sums[b, own.driver if own.leader_began else leader].near_misses_to += 1
