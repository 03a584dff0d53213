"""Drivers that suit the moment at which they start.

A population knows a driver's parameters given the first time gap and the leader's speed. Some drawn
drivers would nevertheless brake or accelerate hard at once, because they want another speed or gap
than the one at which they start. Recorded drivers do not. So up to `TRIES` drivers are drawn, and a
driver is kept with the probability exp(-(a / `DEVIATION_MPS2`)^2 / 2), where a is the first
acceleration without noise. If none is kept, the driver with the smallest |a| is used.
"""

from collections.abc import Callable

import numpy as np

from charms_bench.humans.car_following import Model, drive
from charms_bench.humans.trips import RATE_HZ, Trip
from charms_bench.world.scene import Floats

TRIES = 8
DEVIATION_MPS2 = 0.5


def suited(
    model: Model, trip: Trip, count: int, draw: Callable[[int], Floats], rng: np.random.Generator
) -> Floats:
    """(count, P) drivers from `draw` (n, P) that suit the start of a trip."""
    p = draw(TRIES * count)
    first = first_accelerations(model, trip, p).reshape(TRIES, count)
    is_kept = rng.random(first.shape) < np.exp(-((first / DEVIATION_MPS2) ** 2) / 2)
    rank = np.where(is_kept, np.arange(TRIES)[:, None], TRIES + np.abs(first))
    return np.asarray(p.reshape(TRIES, count, -1)[rank.argmin(axis=0), np.arange(count)])


def first_accelerations(model: Model, trip: Trip, p: Floats) -> Floats:
    """(K,) accelerations, m/s2, of drivers with the parameters p (K, P) at the start of a trip."""
    arrays = trip.gap, trip.speed, trip.leader_x, trip.leader_speed
    _, speeds = drive(model, Trip(trip.driver, *(each[:2] for each in arrays)), p)
    return np.asarray((speeds[:, 1] - speeds[:, 0]) * RATE_HZ)
