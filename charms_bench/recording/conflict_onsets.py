"""Conflicts and near misses between a vehicle and its leader, and which of the two began them.

In a conflict, the bumper-to-bumper TTC is below 1.5 s (Gettman & Head 2003). A near miss is a TTC
below 1.5 s or a DRAC above 3.35 m/s2 (Archer 2005) that ends without a collision. Either ends when
both measures are within their limits again, or when the vehicle gets another leader.

The vehicle whose manoeuvre came last began it: the one that entered the other's lane within the
last 2 s, or else the leader if it brakes by more than 2 m/s2, or else the follower, which closes
in.
"""

from typing import Any

from charms_bench.foundation.compiled import inlined
from charms_bench.recording.primitives import NOBODY, Some, distance_to
from charms_bench.world.gaps import gap_to, is_within, requires_braking
from charms_bench.world.road import Straight
from charms_bench.world.scene import Ints
from charms_bench.world.thresholds import CONFLICT_TTC_S, DRAC_LIMIT_MPS2, HARD_BRAKING_MPS2

MANOEUVRE_S = 2.0
"""A lane change this long ago can have begun a conflict."""


@inlined
def note_conflicts(
    road: Straight,
    some: Some,
    now: Any,
    decision: int,
    interval_s: float,
    ends: bool,
    driver: Ints,
    state: Any,
    sums: Any,
) -> None:
    """Adds the conflicts that begin and the near misses that end."""
    window = round(MANOEUVRE_S / interval_s)
    for i in range(some[0], some[1]):
        own, met = now[i], state[i]
        if own.lost:
            continue
        j = max(own.leader, 0)
        leader = now[j]
        gap = gap_to(distance_to(road, own, leader), own.length, leader.length)
        closing = own.speed - leader.speed
        is_behind = (own.leader >= 0) & (gap > 0)
        is_conflict = is_behind & is_within(gap, closing, CONFLICT_TTC_S)
        brakes_hard = is_behind & requires_braking(gap, closing, DRAC_LIMIT_MPS2)
        is_near_miss = is_conflict | brakes_hard
        if not is_near_miss and met.near < 0:
            continue
        mine, its = sums[driver[i]], sums[driver[j]]
        if met.near >= 0 and not (is_near_miss and j == met.near):
            count_near_miss(met.leader_began, mine, sums[driver[met.near]])
            met.near = NOBODY
        if is_near_miss and met.near < 0:
            leader_changed = leader.lane_since
            if leader.lane != own.lane and leader.target_lane == own.lane:
                leader_changed = decision  # it is on both lanes, and is entering this one
            if max(own.lane_since, leader_changed) >= decision - window:
                met.leader_began = leader_changed > own.lane_since
            else:
                met.leader_began = leader.acceleration < -HARD_BRAKING_MPS2
            met.near, met.in_conflict = j, False
        if is_conflict and not met.in_conflict:
            met.in_conflict = True
            by, to = (its, mine) if met.leader_began else (mine, its)
            by.conflicts_by += 1
            to.conflicts_to += 1
        if met.near >= 0 and ends:
            count_near_miss(met.leader_began, mine, sums[driver[met.near]])


@inlined
def count_near_miss(leader_began: bool, mine: Any, its: Any) -> None:
    """Adds a near miss of a vehicle with its leader to the sums of both drivers."""
    by, to = (its, mine) if leader_began else (mine, its)
    by.near_misses_by += 1
    to.near_misses_to += 1
