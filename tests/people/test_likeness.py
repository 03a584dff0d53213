"""The likeness score with known drivers: recorded ones are drawn from a packaged population."""

from dataclasses import replace

import numpy as np
import pytest

from charms_bench.people.calibration import conditional, ou_noise, situation_of
from charms_bench.people.car_following import IDM, drive
from charms_bench.people.held_out import scales_of, starts
from charms_bench.people.likeness import Driven, Yardstick, recorded
from charms_bench.people.population import read_population
from charms_bench.people.trips import RATE_HZ, Trip
from charms_bench.statistics.energy_score import energy_score
from charms_bench.world.scene import Floats

POPULATION = read_population("i24")
LANES = np.column_stack([np.full(40, 2.5), np.arange(40) % 2, np.zeros(40)])
REPETITIONS = 6


def drivers(rng: np.random.Generator, trip: Trip, count: int, scale: float = 1.0) -> Floats:
    mean, spread = conditional(*POPULATION.arrays, situation_of([trip]))
    return np.exp(rng.multivariate_normal(mean, spread, size=count)) * [1, 1, 1, scale, scale]


def driven(trip: Trip, p: Floats, rng: np.random.Generator, scale: float = 1.0):
    noise = ou_noise(rng, (len(p), trip.gap.size), scale * POPULATION.noise_mps2, 1.5)
    return drive(IDM, trip, p, 0.0, noise)


def people(count: int = 40) -> list[Trip]:
    """Trips of 60 s of drawn drivers, behind leaders whose speed varies."""
    rng, found = np.random.default_rng(0), []
    for d in range(count):
        time = np.arange(60 * RATE_HZ + 1) / RATE_HZ
        speed = 26 + ou_noise(rng, (1, time.size), 2.5, 20.0)[0]
        kernel = np.ones(21) / 21
        speed = np.convolve(np.pad(speed, 10, mode="edge"), kernel, mode="valid")
        leader_x = 40.0 + np.concatenate([[0.0], np.cumsum(speed[:-1])]) / RATE_HZ
        trip = Trip(d, np.full(time.size, 40.0), speed, leader_x, speed)
        gaps, speeds = driven(trip, drivers(rng, trip, 1), rng)
        found.append(Trip(d, gaps[0], speeds[0], leader_x, speed))
    return found


class Case:
    """People, the yardstick that they make, and drivers in their place."""

    def __init__(self) -> None:
        self.trips = people()
        self.parts = starts(self.trips)
        self.human = recorded(self.parts, LANES)
        still = LANES * [1, 0, 0]
        constant = self.of(lambda part, rng: self.along(part, np.full((1, 301), part.speed[0])))
        spawn = self.of(
            lambda part, rng: driven(part, np.array([[part.speed[0], 1, 5, 3, 5]]), rng, 0)
        )
        self.calibrated = self.of(
            lambda part, rng: driven(part, drivers(rng, part, REPETITIONS), rng)
        )
        marks = [replace(each, lanes=still) for each in (constant, spawn)]
        self.yardstick = Yardstick(self.human, *marks, self.calibrated, scales_of(self.trips))

    def of(self, driver) -> Driven:
        rng = np.random.default_rng(1)
        both = [driver(part, rng) for part in self.parts]
        gaps, speeds = (np.array([each[k][:, ::RATE_HZ] for each in both]) for k in range(2))
        return Driven(self.human.driver, gaps, speeds, self.human.leader_speed, LANES)

    def along(self, part: Trip, speeds: Floats) -> tuple[Floats, Floats]:
        driven_m = np.cumsum(speeds[:, :-1], axis=1) / RATE_HZ
        return part.leader_x - np.pad(driven_m, ((0, 0), (1, 0))), speeds

    def copier(self, part: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Draws each second's acceleration from the recorded ones."""
        recorded = np.diff(self.human.speed[:, 0], axis=1).ravel()
        each = np.repeat(rng.choice(recorded, (REPETITIONS, 30)), RATE_HZ, axis=1) / RATE_HZ
        return self.along(part, part.speed[0] + np.pad(np.cumsum(each, axis=1), ((0, 0), (1, 0))))

    def blind(self, part: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Repeats what recorded drivers did in other situations."""
        others = [self.parts[k] for k in rng.integers(len(self.parts), size=REPETITIONS)]
        speeds = np.array([each.speed - each.speed[0] + part.speed[0] for each in others])
        return self.along(part, speeds)

    def bang_bang(self, part: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Accelerates or brakes by 1 m/s2, for a time gap of 1.4 s."""
        speeds, x = np.full((1, part.gap.size), part.speed[0]), part.leader_x[0] - part.gap[0]
        for k in range(1, part.gap.size):
            is_far = part.leader_x[k - 1] - x > 1.4 * speeds[0, k - 1] + 2
            x += speeds[0, k - 1] / RATE_HZ
            speeds[0, k] = speeds[0, k - 1] + (0.1 if is_far else -0.1)
        return self.along(part, speeds)


@pytest.fixture(scope="module")
def case() -> Case:
    return Case()


def test_the_energy_score_of_a_point_is_its_distance():
    assert energy_score(np.array([[[0.0, 0.0]]]), np.array([[3.0, 4.0]])) == pytest.approx(5.0)


def test_the_energy_score_of_two_draws_is_that_of_the_definition():
    draws = np.array([[[0.0], [2.0]]])
    assert energy_score(draws, np.array([[3.0]])) == pytest.approx((3 + 1) / 2 - 2 / 2)


def test_the_energy_score_is_best_for_the_true_distribution():
    rng = np.random.default_rng(0)
    observed = rng.normal(size=(4000, 1))
    means = [
        energy_score(rng.normal(scale=s, size=(4000, 16, 1)), observed).mean()
        for s in (0.6, 1, 1.6)
    ]
    assert means[1] == min(means)


def test_constant_velocity_scores_0_in_the_closed_loop(case: Case):
    constant = case.of(lambda part, rng: case.along(part, np.full((1, 301), part.speed[0])))
    assert case.yardstick.scores(constant)["closed_loop"].value == pytest.approx(0.0)


def test_drivers_from_the_same_population_reach_the_ceiling(case: Case):
    found, ceiling = case.yardstick.scores(case.calibrated), case.yardstick.ceiling()
    assert found["closed_loop"].value == pytest.approx(1.0)
    for name, bounds in ceiling.items():
        assert found[name].high > bounds.low
    assert found["given_scene"].value == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("control", ["copier", "blind", "bang_bang"])
def test_a_driver_that_copies_or_oscillates_scores_below_a_calibrated_one(case: Case, control: str):
    found = case.yardstick.differences(case.calibrated, case.of(getattr(case, control)))
    assert found["total"].high < 0


def test_headways_20_percent_longer_lower_the_closed_loop_and_the_total(case: Case):
    longer = replace(case.calibrated, gap=case.calibrated.gap * 1.2)
    found = case.yardstick.differences(case.calibrated, longer)
    assert found["closed_loop"].high < 0
    assert found["total"].high < 0


def test_doubled_accelerations_lower_the_scene_and_the_total(case: Case):
    start = case.calibrated.speed[..., :1]
    doubled = replace(case.calibrated, speed=start + 2 * (case.calibrated.speed - start))
    found = case.yardstick.differences(case.calibrated, doubled)
    assert found["given_scene"].high < 0
    assert found["total"].high < 0


def test_five_times_the_lane_changes_lower_the_events_and_the_total(case: Case):
    more = replace(case.calibrated, lanes=LANES * [1, 5, 1])
    found = case.yardstick.differences(case.calibrated, more)
    assert found["events"].high < 0
    assert found["total"].high < 0
    assert found["closed_loop"].value == found["given_scene"].value == 0
