"""Post-encroachment time (PET) of vehicles that cut in (Allen, Shin & Cooper 1978).

PET is the time between one vehicle leaving a place and another one reaching it. When the nearest
lane of a vehicle changes, the place is its rear at that moment; the other vehicle is its follower
on the new lane. Times between two decisions are interpolated linearly. There is no PET if the two
overlap along the road, if the follower leaves the lane or crashes first, if a vehicle cuts in
between, the same one included, or after 5 s.
"""

from typing import Any

from charms_bench.foundation.compiled import compiled, index
from charms_bench.world.scene import Ints, Scene

PET_LIMIT_S = 5.0
"""A longer PET is not recorded (FHWA's Surrogate Safety Assessment Model)."""
SHORT_PET_S = 2.0
"""SUMO's threshold (`MSDevice_SSM`)."""
NOBODY = -1


@compiled
def note_encroachments(
    scene: Scene, scenes: Ints, steps: Ints, interval_s: float, state: Any, sums: Any
) -> None:
    """Adds the PETs of vehicles that reach the place, then notes the vehicles that cut in."""
    x, lanes, followers, length = scene.x, scene.lane, scene.followers, scene.length
    for row in scenes:
        b = index(row)
        step = steps[b]
        for i in range(x.shape[1]):
            own = state[b, i]
            if own.cutter < 0:
                continue
            driven = (step - 1 - own.cut_in) * interval_s
            if own.lost or lanes[b, i] != own.lane or driven > PET_LIMIT_S:
                own.cutter = NOBODY
            elif x[b, i] >= own.place:
                pet = driven + (own.place - own.x) / (x[b, i] - own.x) * interval_s
                if pet <= PET_LIMIT_S:
                    first, second = sums[b, state[b, own.cutter].driver], sums[b, own.driver]
                    first.pet_by += 1
                    first.pet_by_sum_s += pet
                    first.pet_below_2s_by += pet < SHORT_PET_S
                    second.pet_to += 1
                    second.pet_to_sum_s += pet
                    second.pet_below_2s_to += pet < SHORT_PET_S
                own.cutter = NOBODY
        for i in range(x.shape[1]):
            own, lane = state[b, i], lanes[b, i]
            if own.lost or lane == own.lane:
                continue
            j = followers[b, i, lane]
            if j < 0 or state[b, j].lost or lanes[b, j] != lane:
                continue
            other, place = state[b, j], x[b, i] - (length[b, j] + length[b, i]) / 2
            other.cutter = NOBODY
            if place > x[b, j]:
                other.cutter, other.place, other.cut_in = i, place, step
