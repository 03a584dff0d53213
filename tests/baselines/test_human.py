"""The drivers that are drawn from a calibrated population."""

import numpy as np
import pytest
from charms_baselines.human import QUANTILES, Human, _normal
from charms_baselines.idm_mobil import IdmMobil
from scipy import stats

from charms_bench.engine.simulation import Simulation
from charms_bench.errors import DataError
from charms_bench.humans.car_following import IDM
from charms_bench.humans.population import read_population
from charms_bench.humans.suited_drivers import suited
from charms_bench.humans.trips import Trip
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.scene import Floats, SceneSettings

SETTINGS = SceneSettings(traffic_vehicles=6)


def driven(scenes: int, decisions: int, seed: int = 0) -> Simulation:
    agents = {"human": Human(), "idm_mobil": IdmMobil()}
    simulation = Simulation(SETTINGS, scenes, "idm_mobil", OneAgent("human"), agents)
    simulation.reset(np.arange(seed, seed + scenes, dtype=np.uint64))
    for _ in range(decisions):
        simulation.step()
    return simulation


def test_quantiles_become_standard_normal_numbers():
    quantiles = np.array([0.01, 0.1, 0.5, 0.9, 0.99])
    found = [_normal(each) for each in quantiles]
    assert found == pytest.approx(stats.norm.ppf(quantiles), abs=0.02)


def test_drivers_are_drawn_as_the_population_says_and_suit_the_start():
    scene = driven(600, 1).scene
    mean, covariance = read_population("i75").arrays
    is_first = scene.rank == SETTINGS.vehicles - 1  # no leader
    is_first[np.arange(600), scene.ego] = False
    logarithms = np.log(scene.memory[is_first][:, -len(QUANTILES) :])
    speeds = scene.target_speed[is_first]
    slope = covariance[:5, -1] / covariance[-1, -1]
    spread = covariance[:5, :5] - np.outer(slope, slope) * covariance[-1, -1]
    rng, expected = np.random.default_rng(0), []
    for speed in speeds:
        given = mean[:5] + slope * (np.log(speed) - mean[-1])
        free = Trip(0, *(np.full(2, each) for each in (1e9, speed, 1e9, speed)))

        def draw(count: int, given: Floats = given) -> Floats:
            return np.exp(rng.multivariate_normal(given, spread, size=count))

        expected.append(np.log(suited(IDM, free, 1, draw, rng)[0]))
    around = np.array(expected)
    assert logarithms.mean(axis=0) == pytest.approx(around.mean(axis=0), abs=0.1)
    assert np.cov(logarithms.T) == pytest.approx(np.cov(around.T), abs=0.08)


def test_few_drivers_brake_hard_in_the_first_seconds():
    simulation = driven(200, 0)
    before = simulation.scene.speed.copy()
    simulation.step()
    simulation.step()
    simulation.step()
    braking = before - simulation.scene.speed
    braking[np.arange(200), simulation.scene.ego] = 0.0
    assert (braking > 1.5).mean() < 0.02


def test_drivers_who_start_close_behind_a_leader_want_a_shorter_jam_gap():
    scene = driven(400, 1).scene
    jam_gap = scene.memory[..., -len(QUANTILES) + 2]
    rows, ranks = np.nonzero(scene.rank < SETTINGS.vehicles - 1)
    leader, present = scene.leader((rows, ranks), scene.lane[rows, ranks])
    is_driver = present & (ranks != scene.ego[rows])
    gap = scene.x[rows, leader] - scene.x[rows, ranks]
    near, far = (jam_gap[rows, ranks][is_driver & each] for each in (gap < 40, gap > 60))
    assert np.median(near) < np.median(far)


def test_drivers_do_not_depend_on_the_other_scenes_of_a_batch():
    both, second = driven(2, 12).scene, driven(1, 12, seed=1).scene
    assert (both.x[1] == second.x[0]).all()


def test_no_driver_collides_in_traffic_of_drawn_drivers():
    assert not driven(60, 60).scene.crashed.any()


def test_an_unknown_population_is_rejected_with_the_known_ones():
    with pytest.raises(DataError, match=r"no population named 'i57'; .* Known: i24, i75"):
        Human("i57")


def test_constants_have_the_same_bits_on_every_processor():
    driving = Human()._driving
    for each in driving[:4]:
        assert (each == each.round(9)).all()
