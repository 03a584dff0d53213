"""Simple models of following, which a model of drivers has to beat.

Both look at the scene, and know of held-out drivers only what these know at the start. One keeps
the first time gap; the other does what fitted drivers did in similar moments. Both have the noise
of a population.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from charms_bench.humans.calibration import ou_noise
from charms_bench.humans.population import Population
from charms_bench.humans.trips import RATE_HZ, Driver, Trip
from charms_bench.world.gaps import time_headway
from charms_bench.world.scene import Floats

REPETITIONS = 8
GAP_GAIN_HZ2, SPEED_GAIN_HZ = 0.02, 0.5
"""Of 16 pairs, the one that fits the gaps of the fitted drivers best, on I-75 and on I-24."""
NEIGHBOURS = 30


def constant_time_gap(population: Population) -> Driver:
    """Keeps the first time gap."""

    def drives(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        wanted = partial(keeping, time_headway(trip.gap[0], trip.speed[0]))
        return _behind(trip, wanted, _noise(trip, population, rng))

    return drives


def keeping(
    time_gap_s: float | Floats, gap: Floats, speed: Floats, leader_speed: float | Floats
) -> Floats:
    """Accelerations, m/s2, towards a time gap and the leader's speed."""
    wanted = GAP_GAIN_HZ2 * (gap - time_gap_s * speed)
    return np.asarray(wanted + SPEED_GAIN_HZ * (leader_speed - speed))


def _noise(trip: Trip, population: Population, rng: np.random.Generator) -> Floats:
    shape = REPETITIONS, trip.gap.size
    return ou_noise(rng, shape, population.noise_mps2, population.noise_s)


def nearest_neighbours(trips: Sequence[Trip], population: Population) -> Driver:
    """Takes the mean acceleration of the next second of the most similar moments of the trips.

    Moments are similar in the gap, the speed and the closing speed, each over its deviation.
    """
    from scipy.spatial import KDTree

    every = slice(None, -RATE_HZ, RATE_HZ)
    moments = [(each.gap, each.speed, each.speed - each.leader_speed) for each in trips]
    known = np.concatenate([np.stack(each, axis=-1)[every] for each in moments])
    taken = np.concatenate([np.diff(each.speed[::RATE_HZ]) for each in trips])
    scale = known.std(axis=0)
    tree = KDTree(known / scale)

    def wanted(gap: Floats, speed: Floats, leader_speed: float) -> Floats:
        moment = np.stack([gap, speed, speed - leader_speed], axis=-1)
        near = tree.query(moment / scale, min(NEIGHBOURS, len(known)))[1]
        return np.asarray(taken[near].mean(axis=-1))

    def drives(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        return _behind(trip, wanted, _noise(trip, population, rng), RATE_HZ)

    return drives


def _behind(
    trip: Trip, wanted: Callable[[Floats, Floats, float], Floats], noise: Floats, every: int = 1
) -> tuple[Floats, Floats]:
    """Drives by accelerations that are wanted in each of `every` rows, and noise (M, n)."""
    gaps, speeds = np.empty(noise.shape), np.empty(noise.shape)
    x, speed = trip.leader_x[0] - trip.gap[0], np.full(len(noise), trip.speed[0])
    for k in range(trip.gap.size):
        gaps[:, k], speeds[:, k] = trip.leader_x[k] - x, speed
        if k % every == 0:
            acceleration = wanted(gaps[:, k], speed, float(trip.leader_speed[k]))
        x = x + speed / RATE_HZ
        speed = np.maximum(speed + (acceleration + noise[:, k]) / RATE_HZ, 0.0)
    return gaps, speeds
