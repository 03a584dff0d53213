"""Situations that no recording has, for drivers who recognise a recorded one by its start.

The gap and the speeds at the start of a recorded situation are changed at random, and its leader
gets the changes of speed of two recorded leaders, each divided by the root of 2. So leaders brake
and accelerate as much as recorded ones, and no recorded driver has followed them. It is not known
what a human driver would do there, but it is known how human drivers drive, given the scene.
"""

from collections.abc import Sequence

import numpy as np

from charms_bench.humans.held_out import SEED
from charms_bench.humans.trips import GAPS_M, RATE_HZ, Trip
from charms_bench.world.scene import Floats

GAP_CHANGE = 0.1
"""Standard deviation of the logarithm of the changed over the recorded first gap."""
SPEED_CHANGE_MPS = 0.5
"""Standard deviation of the change of the speeds of driver and leader, together."""
TRIES = 50


def unseen(parts: Sequence[Trip], speeds_mps: tuple[float, float]) -> list[Trip]:
    """One situation for each recorded one; the driver's gap and speed are those of its start.

    Of `TRIES` leaders, the first that stays within the speeds is taken; if none does, the last one
    is clipped to them.
    """
    rng, found = np.random.default_rng([SEED, 1]), []
    for part in parts:
        gap = float(np.clip(part.gap[0] * np.exp(rng.normal() * GAP_CHANGE), *GAPS_M))
        for _ in range(TRIES):
            other = parts[int(rng.integers(len(parts)))]
            shift = rng.normal() * SPEED_CHANGE_MPS
            leader_speed = part.leader_speed[0] + shift + _mixed(part, other)
            speed = part.speed[0] + shift
            slowest, fastest = (f(speed, f(leader_speed)) for f in (min, max))
            if speeds_mps[0] <= slowest and fastest <= speeds_mps[1]:
                break
        speed, leader_speed = np.clip(speed, *speeds_mps), np.clip(leader_speed, *speeds_mps)
        leader_x = gap + np.append(0.0, np.cumsum(leader_speed[:-1])) / RATE_HZ
        gaps, speeds = np.full(leader_x.size, gap), np.full(leader_x.size, speed)
        found.append(Trip(part.driver, gaps, speeds, leader_x, leader_speed))
    return found


def _mixed(one: Trip, other: Trip) -> Floats:
    """(n,) changes of the speed from the start on."""
    changes = (each.leader_speed - each.leader_speed[0] for each in (one, other))
    return np.asarray(sum(changes) / np.sqrt(2))
