"""The likeness score with known drivers: recorded ones are drawn from a packaged population."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from charms_bench.humans.calibration import ou_noise
from charms_bench.humans.car_following import IDM, drive
from charms_bench.humans.driven_situations import Driven, conduct, in_place, recorded
from charms_bench.humans.faulty_drivers import CALIBRATED, calibrated, controls
from charms_bench.humans.held_out import scales_of, starts
from charms_bench.humans.likeness import EVENTS, Yardstick, _jackknifed, _rates, _Sums
from charms_bench.humans.population import read_population
from charms_bench.humans.simple_models import Driver, constant_time_gap, nearest_neighbours
from charms_bench.humans.trips import RATE_HZ, Trip
from charms_bench.humans.unseen_situations import unseen
from charms_bench.statistics.energy_score import energy_score
from charms_bench.world.scene import Floats

POPULATION = read_population("i24")
LANES = np.column_stack([np.full(40, 2.5), np.arange(40) % 2, np.zeros((40, 2))])


def people(count: int = 40) -> list[Trip]:
    """Trips of 60 s of drawn drivers behind leaders whose speed varies, with usual time gaps."""
    rng, found = np.random.default_rng(0), []
    for d in range(count):
        time = np.arange(60 * RATE_HZ + 1) / RATE_HZ
        speed = 26 + ou_noise(rng, (1, time.size), 2.5, 20.0)[0]
        kernel = np.ones(21) / 21
        speed = np.convolve(np.pad(speed, 10, mode="edge"), kernel, mode="valid")
        gap = speed[0] * rng.lognormal(np.log(1.4), 0.4)
        leader_x = gap + np.concatenate([[0.0], np.cumsum(speed[:-1])]) / RATE_HZ
        trip = Trip(d, np.full(time.size, gap), speed, leader_x, speed)
        gaps, speeds = calibrated(POPULATION)(trip, rng)
        found.append(Trip(d, gaps[0], speeds[0], leader_x, speed))
    return found


class Case:
    """People, the yardstick that they make, and drivers in their place."""

    def __init__(self) -> None:
        trips = people()
        self.trips, self.parts = trips, starts(trips)
        self.human = recorded(self.parts, LANES)
        self.parts += unseen(self.parts, (0.0, 50.0))
        self.controls = controls(self.parts, self.human, POPULATION)
        self.calibrated = self.controls[CALIBRATED]
        marks = [replace(self.of(each), lanes=LANES * [1, 0, 0, 0]) for each in (constant, eager)]
        self.yardstick = Yardstick(self.human, *marks, self.calibrated, scales_of(trips))

    def of(self, driver: Driver) -> Driven:
        return in_place(self.parts, LANES, driver)


def constant(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
    time_s = np.arange(trip.gap.size) / RATE_HZ
    speed = np.full((1, time_s.size), trip.speed[0])
    return trip.leader_x[None] - trip.speed[0] * time_s, speed


def eager(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """An IDM that wants the speed at which it starts."""
    return drive(IDM, trip, np.array([[trip.speed[0], 1.0, 5.0, 3.0, 5.0]]))


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
    found = case.yardstick.scores(case.of(constant))
    assert found["closed_loop"].value == pytest.approx(0.0)


def test_drivers_from_the_same_population_reach_the_ceiling(case: Case):
    found = case.yardstick.scores(case.controls["another draw"])
    assert found["closed_loop"].value == pytest.approx(1.0, abs=0.1)
    assert found["given_scene"].value == pytest.approx(1.0, abs=0.15)
    for each in found.values():
        assert each.low < 1 < each.high + 0.1


def test_other_people_reach_the_ceiling_within_their_interval(case: Case):
    driven = case.calibrated.of(slice(len(case.human.driver)))
    others = replace(driven, gap=driven.gap[:, :1], speed=driven.speed[:, :1])
    found = case.yardstick.of_others(others)
    assert set(found) == {"given_scene", "events"}
    for each in found.values():
        assert each.low <= 1 <= each.high


@pytest.mark.parametrize(
    "control",
    [
        "accelerations drawn independently",
        "sequences of other situations",
        "braking or accelerating by 1 m/s2",
    ],
)
def test_a_driver_that_copies_or_oscillates_scores_below_a_calibrated_one(case: Case, control: str):
    found = case.yardstick.differences(case.calibrated, case.controls[control])
    assert found["total"].high < 0


def test_a_memory_of_the_recordings_wins_only_the_closed_loop(case: Case):
    found = case.yardstick.scores(case.controls["the recording with the nearest start"])
    assert found["closed_loop"].value > 1
    assert found["total"].high < 0


def test_unseen_situations_have_neither_the_start_nor_the_leader_of_a_recorded_one(case: Case):
    seen, new = np.split(np.array([[each.gap[0], each.speed[0]] for each in case.parts]), 2)
    assert np.abs(np.log(new[:, 0] / seen[:, 0])).mean() == pytest.approx(0.08, abs=0.03)
    assert not (new[:, None] == seen).any()
    of_leaders = np.array([np.diff(each.leader_speed) for each in case.parts])
    recorded_ones, others = np.split(of_leaders, 2)
    assert others.std() == pytest.approx(recorded_ones.std(), rel=0.15)
    assert np.corrcoef(others[0], recorded_ones[0])[0, 1] < 0.95


def test_simple_models_keep_the_time_gap_of_recorded_drivers(case: Case):
    parts = case.parts[::8]
    time_gap = np.median([part.gap[0] / part.speed[0] for part in parts])
    for driver in (constant_time_gap(POPULATION), nearest_neighbours(case.trips, POPULATION)):
        driven = in_place(parts, LANES, driver)
        assert driven.collided.mean() < 0.1
        assert conduct(driven)["time_gap_median_s"] == pytest.approx(time_gap, rel=0.15)


def test_a_collision_of_all_drivers_together_doubles_a_rate_without_collisions(case: Case):
    gap, lanes = case.calibrated.gap.copy(), LANES.copy()
    gap[0, 0, 15], lanes[0, 3] = 0.0, 1.0
    every, km = np.ones((1, 40)), LANES[:, 0].sum(keepdims=True)
    ratio = [
        _rates(_Sums(driven), every, driven.lanes.sum(axis=0, keepdims=True), km)[0]
        for driven in (replace(case.calibrated, gap=gap, lanes=lanes), case.calibrated)
    ]
    times = dict(zip(EVENTS, ratio[0] / ratio[1], strict=True))
    assert times["collision"] == times["collision_in_traffic"] == pytest.approx(2.0)
    assert times["lane_change"] == times["hard_braking"] == 1.0


@pytest.mark.parametrize(
    ("change", "component"),
    [
        ("headways 20 % longer", "closed_loop"),
        ("accelerations x 2", "given_scene"),
        ("lane changes x 5", "events"),
    ],
)
def test_a_known_change_lowers_its_component_and_the_total(case: Case, change: str, component: str):
    found = case.yardstick.differences(case.calibrated, case.controls[change])
    assert found[component].high < 0
    assert found["total"].high < 0


def test_lane_changes_do_not_change_the_components_of_the_lane(case: Case):
    found = case.yardstick.differences(case.calibrated, case.controls["lane changes x 5"])
    assert found["closed_loop"].value == found["given_scene"].value == 0


def test_one_event_of_one_driver_does_not_decide_a_score(case: Case):
    speed = case.calibrated.speed.copy()
    speed[-1, :, 20:] -= 2.0  # one second of hard braking
    found = case.yardstick.differences(case.calibrated, replace(case.calibrated, speed=speed))
    assert abs(found["events"].value) < 0.2


def test_intervals_are_those_of_the_jackknife():
    # Of a mean, the jackknife gives the usual standard error.
    values = np.random.default_rng(0).normal(size=30)
    without = (values.sum() - values) / 29
    found = _jackknifed(np.append(values.mean(), without)[:, None])[1:, 0]
    assert found == pytest.approx(stats.t.interval(0.95, 29, values.mean(), stats.sem(values)))


def test_conduct_counts_seconds():
    # 30, 31, 30, 30, 28 m/s at 1 Hz: one reversal in three pairs, hard braking in one of four.
    speed = np.array([[[30.0, 31.0, 30.0, 30.0, 28.0]]])
    gap = np.array([[[9.0, 31.0, 15.0, 15.0, 56.0]]])
    driven = Driven(np.zeros(1, int), gap, speed, speed, np.array([[4.0, 2.0, 1.0, 0.0]]))
    assert conduct(driven) == {
        "seconds": 4.0,
        "acceleration_std_mps2": pytest.approx(np.std([1, -1, 0, -2])),
        "strong_acceleration": 0.25,
        "reversals_per_minute": pytest.approx(20.0),
        "hard_braking_per_h": 900.0,
        "time_gap_median_s": pytest.approx(0.75),
        "short_headway": 0.5,
        "collided": 0.0,
        "collisions_per_1000km": 0.0,
        "lane_changes_per_km": 0.5,
        "undone_lane_changes": 0.5,
    }
