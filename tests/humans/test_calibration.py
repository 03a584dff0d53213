"""Fits of populations to trips, and the trips themselves."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy import stats
from scipy.special import expit

from charms_bench.errors import DataError
from charms_bench.humans.calibration import fit_population, noise_of, ou_noise, situation_of
from charms_bench.humans.car_following import FVDM, IDM, drive
from charms_bench.humans.held_out import drawn, ratio_interval, starts
from charms_bench.humans.lane_choices import Choices, fit_choices, read_choices
from charms_bench.humans.population import LaneChanges
from charms_bench.humans.trips import RATE_HZ, Trip, read_trips, split

DATA = Path(__file__).parents[2] / "../shared/data"


def trip_behind(
    leader_speed: np.ndarray, gap_m: float, p: np.ndarray, driver: int = 0, noise: float = 0.0
) -> Trip:
    """A trip of an IDM driver who starts with the leader's speed."""
    leader_x = gap_m + np.concatenate([[0.0], np.cumsum(leader_speed[:-1])]) / RATE_HZ
    given = np.full(leader_speed.size, [gap_m]), leader_speed
    trip = Trip(driver, *given, leader_x, leader_speed)
    pushes = ou_noise(np.random.default_rng(driver), (1, leader_speed.size), noise + 1e-9, 1.5)
    gaps, speeds = drive(IDM, trip, p[None], noise=pushes)
    return Trip(driver, gaps[0], speeds[0], leader_x, leader_speed)


def waves(driver: int, seconds: int = 120) -> np.ndarray:
    time = np.arange(seconds * RATE_HZ) / RATE_HZ
    return 20 + 6 * np.sin(2 * np.pi * time / 60 + driver) + 2 * np.sin(2 * np.pi * time / 17)


def test_idm_settles_at_its_equilibrium_gap():
    p = np.array(IDM.usual)
    trip = trip_behind(np.full(6000, 20.0), 40.0, p)
    expected = (2.0 + 20.0 * 1.6) / np.sqrt(1 - (20 / 33.3) ** 4)
    assert trip.gap[-1] == pytest.approx(expected, abs=0.01)


def test_fvdm_settles_at_its_equilibrium_gap():
    trip = trip_behind(np.full(6000, 20.0), 40.0, np.array(IDM.usual))
    gaps, _ = drive(FVDM, trip, np.array(FVDM.usual)[None])
    assert gaps[0, -1] == pytest.approx(2.0 + 20.0 * 1.2, abs=0.01)


def test_a_population_is_recovered_from_its_drivers():
    rng = np.random.default_rng(0)
    spread = np.array([0.05, 0.3, 0.2, 0.2, 0.2])
    logarithms = np.log(IDM.usual) + rng.normal(size=(16, 5)) * spread
    trips = [trip_behind(waves(d), 35.0, np.exp(p), d) for d, p in enumerate(logarithms)]
    fit = fit_population(IDM, trips, 0.0)
    drivers_own = np.exp(fit.modes[:, 1] - logarithms[:, 1])
    assert drivers_own == pytest.approx(1.0, abs=0.15)
    assert fit.mean[1] == pytest.approx(logarithms[:, 1].mean(), abs=0.1)
    assert np.sqrt(fit.covariance[1, 1]) == pytest.approx(0.3, abs=0.1)


def test_what_one_steady_speed_does_not_tell_is_flagged():
    steady = np.full(600, 15.0)
    trips = [trip_behind(steady, 26.0, np.array(IDM.usual), d, noise=0.1) for d in range(4)]
    fit = fit_population(IDM, trips, 0.0)
    flagged = dict(zip(IDM.parameters, fit.is_unidentified, strict=True))
    assert flagged["desired_speed_mps"]
    assert flagged["deceleration_mps2"]


def test_noise_is_recovered_from_drivers_with_noise():
    trips = [trip_behind(waves(d), 35.0, np.array(IDM.usual), d, noise=0.3) for d in range(8)]
    deviation, time_s = noise_of(fit_population(IDM, trips, 0.0), trips)
    assert deviation == pytest.approx(0.3, rel=0.25)
    assert time_s == pytest.approx(1.5, rel=0.4)


def test_noise_has_the_correlation_of_its_process():
    noise = ou_noise(np.random.default_rng(0), (2000, 41), 0.5, 2.0)
    assert noise.std() == pytest.approx(0.5, rel=0.03)
    assert np.corrcoef(noise[:, 0], noise[:, 20])[0, 1] == pytest.approx(np.exp(-1), abs=0.06)


def test_the_split_separates_drivers():
    trips = [trip_behind(waves(d, 20), 35.0, np.array(IDM.usual), d // 2) for d in range(20)]
    fitted, held_out = ({trip.driver for trip in part} for part in split(trips))
    assert len(fitted) == len(held_out) == 5
    assert not fitted & held_out


def test_predictions_start_with_the_recorded_gap():
    trip = trip_behind(waves(3), 35.0, np.array(IDM.usual))
    parts = starts([trip])
    assert len(parts) == 9
    assert [part.leader_x[0] for part in parts] == [part.gap[0] for part in parts]
    assert situation_of([trip])[0] == pytest.approx(np.log(35.0 / trip.speed[0]))


def test_a_prediction_knows_nothing_of_the_trip_beyond_its_start():
    trip = trip_behind(waves(3), 35.0, np.array(IDM.usual))
    fit = fit_population(
        IDM, [trip_behind(waves(d), 35.0, np.array(IDM.usual), d) for d in range(3)], 0.0
    )
    later = np.arange(trip.gap.size) >= 100
    other = replace(trip, gap=trip.gap + later, speed=trip.speed + later,
                    leader_x=trip.leader_x + later * np.arange(later.size),
                    leader_speed=trip.leader_speed + 10 * later)  # fmt: skip
    predict = drawn(fit, (0.1, 1.5))
    one, two = (predict(each, np.random.default_rng(0))[0] for each in (trip, other))
    np.testing.assert_array_equal(one[:, :100], two[:, :100])


def test_the_interval_of_a_ratio_contains_it():
    one = stats.expon.rvs(size=100, random_state=1)
    value, low, high = ratio_interval(one, 2 * one, root=True)
    assert low == pytest.approx(np.sqrt(0.5)) == value == pytest.approx(high)


def simulate_choices(choices: Choices, behaviour: LaneChanges, rng: np.random.Generator) -> Choices:
    """The same choices, made by drivers with this behaviour."""
    probability = expit((choices.gain - behaviour.threshold_mps2) / behaviour.scale_mps2)
    probability *= choices.speed / behaviour.speed_mps
    changed = rng.random(probability.size) < probability
    return choices._replace(changed=changed, recorded=int(changed.sum()))


def test_a_threshold_is_recovered_from_37_simulated_lane_changes():
    gain = np.random.default_rng(0).normal(size=2200)
    known = LaneChanges(threshold_mps2=3.2, scale_mps2=0.6, speed_mps=20.0, changes=0)
    choices = Choices(gain, gain > 9, np.full(gain.size, 20.0), 0, 100.0)
    found = []
    for seed in range(60):
        simulated = simulate_choices(choices, known, np.random.default_rng(seed))
        if (behaviour := fit_choices(simulated)) is not None:
            found.append((behaviour.threshold_mps2, behaviour.scale_mps2, behaviour.changes))
    threshold, scale, changes = np.median(found, axis=0)
    assert changes == pytest.approx(37, abs=12)
    assert (threshold, scale) == pytest.approx((3.2, 0.6), rel=0.15)


def test_fewer_than_ten_lane_changes_are_not_fitted():
    assert fit_choices(Choices(np.zeros(100), np.arange(100) < 9, np.ones(100), 9, 1.0)) is None


def test_another_table_is_rejected_with_its_columns(tmp_path: Path):
    pl.DataFrame({"a": [1]}).write_parquet(tmp_path / "x.parquet")
    with pytest.raises(DataError, match=r"x.parquet: expected the columns run, .* found a"):
        read_trips(tmp_path / "x.parquet")


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data, human recordings")
def test_trips_of_i75_have_one_leader_each():
    trips = read_trips(DATA / "i75_lane_trajectories.parquet")
    assert len({trip.driver for trip in trips}) == 76
    for trip in trips:
        assert trip.gap.min() >= 1
        assert trip.gap.max() <= 100
        assert np.abs(np.diff(trip.gap)).max() < 2


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data, human recordings")
def test_lane_changes_of_i75_have_the_published_rate():
    choices = read_choices(DATA / "i75_lane_trajectories.parquet", np.array(IDM.usual))
    assert choices.recorded / choices.driven_km == pytest.approx(0.24, abs=0.005)


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data, human recordings")
def test_recordings_without_long_trips_are_rejected():
    with pytest.raises(DataError, match="no driver follows one leader for 20 s"):
        read_trips(DATA / "us101_corrected")


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_a_table_that_is_not_a_file_is_not_read(
    make: Callable[[Path], object], tmp_path: Path
) -> None:
    make(tmp_path / "table.parquet")
    with pytest.raises(DataError, match="is a pipe or a device, not a file"):
        read_trips(tmp_path / "table.parquet")
