"""Drivers that are drawn again if they would brake or accelerate hard at once."""

import numpy as np
import pytest

from charms_bench.humans.car_following import IDM
from charms_bench.humans.suited_drivers import DEVIATION_MPS2, TRIES, first_accelerations, suited
from charms_bench.humans.trips import Trip

FREE = Trip(0, np.full(2, 1e9), np.full(2, 25.0), np.full(2, 1e9), np.full(2, 25.0))
"""Nobody ahead, so that the first acceleration is a (1 - (v / v0)^4)."""


def wanting(speeds: np.ndarray) -> np.ndarray:
    return np.column_stack([speeds, *(np.full(speeds.size, each) for each in (1.0, 2.0, 1.0, 1.0))])


def test_the_first_acceleration_is_that_of_idm():
    assert first_accelerations(IDM, FREE, wanting(np.array([25.0, 50.0]))) == pytest.approx(
        [0.0, 1 - 1 / 16]
    )


def test_drivers_are_kept_as_often_as_their_first_acceleration_is_likely():
    # One half wants the speed that it has. The other half brakes by 1 m/s2, two deviations.
    rng, count = np.random.default_rng(0), 40_000
    slow = 25 / 2**0.25

    def draw(n: int) -> np.ndarray:
        return wanting(rng.choice([25.0, slow], size=n))

    assert DEVIATION_MPS2 == 0.5
    kept = np.exp(-2.0)
    # Of TRIES drivers in a row, the first one kept, or a suitable one if there is any, is used.
    each = [0.5 * kept * (0.5 * (1 - kept)) ** k for k in range(TRIES)]
    expected = sum(each) + (0.5 * (1 - kept)) ** TRIES
    found = (suited(IDM, FREE, count, draw, rng)[:, 0] < 25).mean()
    assert found == pytest.approx(expected, abs=0.005)


def test_if_no_driver_suits_the_one_that_suits_best_is_used():
    wanted = iter(np.array([50.0, 5.0, 6.0, 70.0, 7.0, 8.0, 9.0, 10.0])[None])
    best = suited(IDM, FREE, 1, lambda n: wanting(next(wanted)) * [1, 1, 1, 9, 1],
                  np.random.default_rng(0))  # fmt: skip
    assert best[0, 0] == 50.0
