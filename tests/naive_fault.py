"""A plain version of `recording.fault`: it reads whole trajectories and keeps no state."""

from typing import NamedTuple

import numpy as np
from naive_conduct import History, ahead, bumper_gap

from charms_bench.world.road import Straight


class Sample(NamedTuple):
    """A moment at which movements are noted: a frame, and the number of its decision interval.

    Entries are noted in every frame.
    """

    frame: int
    interval: int


def at_fault(h: History, steps_per_decision: int, road: Straight) -> list[bool]:
    """Whether each vehicle collides and is at fault; `h` has a frame for every simulation step."""
    samples = [
        Sample(t, -(-t // steps_per_decision))
        for t in range(1, len(h["x"]))
        if t % steps_per_decision == 0 or (h["collision"][t] != h["collision"][t - 1]).any()
    ]
    return [_is_at_fault(h, i, samples, road) for i in range(h["x"].shape[1])]


def _is_at_fault(h: History, i: int, samples: list[Sample], road: Straight) -> bool:
    frames = np.nonzero(h["collision"][:, i])[0]
    if not frames.size:
        return False
    t, kind = frames[0], h["collision"][frames[0], i]
    past = [each for each in samples if each.frame <= t]
    j = other_of(h, t, i)
    behind, front = sorted((i, j), key=lambda v: bool((kind == 1) == (v != i)))
    if kind == 3 or h["speed"][t, behind] <= h["speed"][t, front]:
        return moved_out(h, i, past, road) >= moved_out(h, j, past, road)
    entrant, frame = last_entry(h, behind, int(t), road)
    return (entrant == front and (t - frame) / 15 <= 2) == (i == front)


def other_of(h: History, t: int, i: int) -> int:
    """The vehicle that overlaps i most."""
    length, width = h["length"][t], h["width"][t]
    depth = np.minimum(
        (length + length[i]) / 2 - abs(h["x"][t] - h["x"][t, i]),
        (width + width[i]) / 2 - abs(h["y"][t] - h["y"][t, i]),
    )
    depth[i] = -np.inf
    return int(depth.argmax())


def moved_out(h: History, i: int, past: list[Sample], road: Straight) -> int:
    """The first interval of the last run of intervals in which i moves out of its lane."""
    beside = h["y"][:, i] - h["lane"][:, i] * road.lane_width
    aside = h["speed"][:, i] * h["direction_y"][:, i]
    out = {
        each.interval
        for each in past
        if abs(beside[each.frame]) > 0.25 and aside[each.frame] * np.sign(beside[each.frame]) > 0.1
    }
    first = max(out, default=-(10**6))
    while first - 1 in out:
        first -= 1
    return first


def last_entry(h: History, behind: int, last: int, road: Straight) -> tuple[int, int]:
    """The last vehicle that entered the lane ahead of another one too closely, and the frame."""
    found, known = (-1, -(10**6)), {}
    for frame in range(1, last + 1):
        for i in range(h["x"].shape[1]):
            lane = int(h["lane"][frame, i])
            beside = h["y"][frame, i] - lane * road.lane_width
            if abs(beside) + h["width"][frame, i] / 2 <= road.lane_width / 2:
                continue
            entered = lane + (1 if beside > 0 else -1)
            both = {lane, entered}
            before, seen = known.get(i, (None, -(10**6)))
            known[i] = (both, frame)
            if (before == both and seen == frame - 1) or not 0 <= entered < road.lanes:
                continue
            j = ahead(h, frame, i, entered, road, -1)
            if j != behind or h["lane"][frame, j] != entered:
                continue
            closing = h["speed"][frame, j] - h["speed"][frame, i]
            gap = bumper_gap(h, frame, j, i)
            if closing > 0 and (gap <= 0 or closing**2 / (2 * gap) > 3.35):
                found = (i, frame)
    return found
