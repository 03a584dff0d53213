"""Post-encroachment time (PET) of vehicles that cut in (Allen, Shin & Cooper 1978).

PET is the time between one vehicle leaving a place and another one reaching it. When the nearest
lane of a vehicle changes, the place is its rear at that moment; the other vehicle is its follower
on the new lane. Times between two decisions are interpolated linearly. There is no PET if the two
overlap along the road, if the follower leaves the lane or crashes first, if a vehicle cuts in
between, the same one included, or after 5 s.
"""

from typing import Any

from charms_bench.foundation.compiled import inlined
from charms_bench.recording.primitives import NOBODY, Some
from charms_bench.world.scene import Ints

PET_LIMIT_S = 5.0
"""A longer PET is not recorded (FHWA's Surrogate Safety Assessment Model)."""
SHORT_PET_S = 2.0
"""SUMO's threshold (`MSDevice_SSM`)."""


@inlined
def note_encroachments(
    some: Some,
    now: Any,
    before: Any,
    itself: Any,
    decision: int,
    interval_s: float,
    driver: Ints,
    state: Any,
    sums: Any,
) -> None:
    """Adds the PETs of vehicles that reach the place, then notes the vehicles that cut in.

    `itself` are all vehicles as each sees itself: the follower finds the place along its own way.
    """
    for i in range(some[0], some[1]):
        own, was, met = now[i], before[i], state[i]
        if met.cutter < 0:
            continue
        driven = (decision - 1 - met.cut_in) * interval_s
        if own.lost or own.lane != was.lane or driven > PET_LIMIT_S:
            met.cutter = NOBODY
        elif own.x >= met.place:
            pet = driven + (met.place - was.x) / (own.x - was.x) * interval_s
            if pet <= PET_LIMIT_S:
                first, second = sums[driver[met.cutter]], sums[driver[i]]
                first.pet_by += 1
                first.pet_by_sum_s += pet
                first.pet_below_2s_by += pet < SHORT_PET_S
                second.pet_to += 1
                second.pet_to_sum_s += pet
                second.pet_below_2s_to += pet < SHORT_PET_S
            met.cutter = NOBODY
    for i in range(some[0], some[1]):
        own, j = now[i], now[i].follower
        if own.lost or own.lane == before[i].lane or j < 0:
            continue
        other, met = now[j], state[j]
        if other.lost or other.lane != own.lane:
            continue
        place = own.x - (other.length + own.length) / 2
        met.cutter = NOBODY
        if place > other.x:
            met.place = place + (itself[j].x - other.x)
            met.cutter, met.cut_in = i, decision
