"""The calibrated IDM+MOBIL of `suites/seeds`: the agent `human` with a population of one driver."""

from pathlib import Path

import numpy as np
import pytest
from charms_baselines.human import FELT, Human
from scenes import all_vehicles, scene_of

from charms_bench.people.calibration import pooled
from charms_bench.people.car_following import IDM
from charms_bench.people.population import read_population
from charms_bench.people.trips import read_trips, split
from charms_bench.world.scene import Ints, Scene

ROOT = Path(__file__).parents[2]
DRIVER = ROOT / "suites/seeds/idm-mobil-i75.json"
DATA = ROOT / "../shared/data"
WANTED_MPS, TIME_GAP_S, JAM_GAP_M, ACCELERATION, DECELERATION = 30.0, 1.2443, 4.2493, 0.7172, 0.4554


def driven(**fields: list[float]) -> tuple[Scene, Ints]:
    """The scene after all have considered a lane change, and the target lanes."""
    scene = scene_of("charms", timer_s=[1.0] * len(fields["x"]), **fields)
    shape = scene.x.shape
    scene = scene._replace(
        parameters=np.random.default_rng(0).random((*shape, len(Human.parameters))),
        memory=np.zeros((*shape, Human.memory_width)),
    )
    return scene, Human(str(DRIVER)).drive(scene.read_only(), all_vehicles(scene))[1]


@pytest.mark.parametrize(("gap_m", "speed"), [(12.0, 24.0), (35.0, 28.0), (70.0, 31.0)])
def test_every_driver_follows_idm_with_the_pooled_parameters(gap_m: float, speed: float) -> None:
    ahead = 25.0
    scene, _ = driven(x=[100.0, 105.0 + gap_m], y=[4.0, 4.0], speed=[speed, ahead])
    braking = speed * (speed - ahead) / (2 * np.sqrt(ACCELERATION * DECELERATION))
    wanted_gap = JAM_GAP_M + max(0.0, speed * TIME_GAP_S + braking)
    free = 1 - np.array([speed, ahead]) ** 4 / WANTED_MPS**4
    expected = ACCELERATION * (free - [(wanted_gap / gap_m) ** 2, 0.0])
    np.testing.assert_allclose(scene.memory[0, :, FELT], expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("leader_speed", "follower_x", "lane"),
    [
        (22.0, -300.0, 0),  # a slow leader, and nobody near on the lane beside
        (22.0, 85.0, 1),  # a follower would have to brake harder than 2 m/s2
        (40.0, -300.0, 1),  # a fast leader, behind whom a change gains less than 0.2 m/s2
    ],
)
def test_lanes_are_chosen_as_by_mobil(leader_speed: float, follower_x: float, lane: int) -> None:
    _, lanes = driven(
        x=[100.0, 150.0, follower_x, 110.0],
        y=[4.0, 4.0, 0.0, 8.0],
        speed=[26.0, leader_speed, 30.0, 26.0],
    )
    assert lanes[0] == lane


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data, human recordings")
def test_the_driver_is_the_pooled_point_of_i75() -> None:
    driver = read_population(str(DRIVER))
    fitted, _ = split(read_trips(DATA / "i75_lane_trajectories.parquet"))
    point = pooled(IDM, fitted, driver.lag_s)
    assert np.exp(driver.mean[1:5]) == pytest.approx(point[1:], rel=1e-3)
    assert point[0] > 100  # it does not identify the desired speed
