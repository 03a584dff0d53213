"""Waymo's realism likelihoods (Montali et al. 2023), and why they are not the likeness score.

The definitions are those of `challenge_2025_sim_agents_config.textproto`: values clipped to the
range, pooled over rollouts and time, pseudocount 0.1, exp of the mean log probability.
"""

from pathlib import Path

import numpy as np
import pytest

from charms_bench.humans.held_out import starts
from charms_bench.humans.trips import read_trips, split
from charms_bench.world.scene import Floats

DATA = Path(__file__).parents[2] / "../shared/data"
SPEED, ACCELERATION = (0.0, 25.0, 10), (-12.0, 12.0, 11)


def likelihood(simulated: Floats, logged: Floats, bins: tuple[float, float, int]) -> float:
    low, high, count = bins
    edges = np.linspace(low, high, count + 1)
    counts = np.histogram(np.clip(simulated, low, high), edges)[0] + 0.1
    index = np.clip(np.searchsorted(edges, np.clip(logged, low, high), "right") - 1, 0, count - 1)
    return float(np.exp(np.log(counts[index] / counts.sum()).mean()))


def test_a_rollout_in_one_bin_has_the_likelihood_of_its_pseudocounts():
    assert likelihood(np.full(100, 12.0), np.full(5, 12.4), SPEED) == pytest.approx(100.1 / 101)


def test_two_equally_likely_bins_have_likelihood_one_half():
    simulated = np.array([1.0, 11.0] * 5000)
    assert likelihood(simulated, np.array([1.0, 11.0, 1.0]), SPEED) == pytest.approx(0.5, abs=1e-3)


def test_values_beyond_the_range_fall_into_the_last_bin():
    assert likelihood(np.full(10, 30.0), np.array([26.0]), SPEED) == pytest.approx(10.1 / 11)


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data, human recordings")
def test_waymos_bins_cannot_tell_constant_velocity_from_recorded_drivers():
    fitted, held_out = (
        starts(part) for part in split(read_trips(DATA / "i24_car_following.parquet"))
    )
    constant, nearest = [], []
    for part in held_out[::10]:
        logged = part.speed[:81]
        other = min(fitted, key=lambda each: abs(each.speed[0] - part.speed[0])).speed[:81]
        for found, speed in ((constant, np.full(81, part.speed[0])), (nearest, other)):
            accelerations = [np.gradient(each, 0.1) for each in (speed, logged)]
            found.append(
                (likelihood(speed, logged, SPEED), likelihood(*accelerations, ACCELERATION))
            )
    assert np.mean(constant) == pytest.approx(np.mean(nearest), abs=0.05)
