"""IDM+MOBIL against its plain version, and by hand."""

import naive
import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import all_vehicles, scene_of, scenes

from charms_bench.world.scene import Scene


def drive(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    return IdmMobil().drive(scene.read_only(), all_vehicles(scene))


@settings(derandomize=True, deadline=None, max_examples=100)
@given(scenes(), st.sampled_from([0.0, 0.5]))
def test_answers_are_those_of_the_plain_version(scene: Scene, politeness: float) -> None:
    parameters = scene.constants.idm_mobil._replace(politeness=politeness)
    scene = scene._replace(constants=scene.constants._replace(idm_mobil=parameters))
    accelerations, targets = naive.idm_mobil(scene)
    acceleration, target_lane = drive(scene)
    assert list(target_lane) == targets
    np.testing.assert_allclose(acceleration, accelerations, rtol=0, atol=1e-9)


def test_on_a_free_road_the_acceleration_is_that_of_equation_3() -> None:
    scene = scene_of(x=[0.0], y=[4.0], speed=[15.0], target_speed=[30.0], temperament=[0.5])
    assert drive(scene)[0][0] == pytest.approx(3 * (1 - 0.5**4))  # a (1 - (v / v0)^4)


def test_a_wanted_speed_above_the_limit_counts_as_the_limit() -> None:
    scene = scene_of(x=[0.0], y=[4.0], speed=[30.0], target_speed=[60.0])
    assert drive(scene)[0][0] == pytest.approx(0.0)


def test_a_follower_at_equal_speed_brakes_by_the_square_of_its_crowding() -> None:
    scene = scene_of(x=[0.0, 80.0], y=[4.0, 4.0], speed=[20.0, 20.0], target_speed=[20.0, 20.0])
    assert drive(scene)[0][0] == pytest.approx(-3 * ((10 + 20 * 1.5) / 80) ** 2)


def test_a_follower_brakes_at_the_limit_when_its_leader_stands() -> None:
    scene = scene_of(x=[0.0, 20.0], y=[4.0, 4.0], speed=[25.0, 0.0], target_speed=[30.0, 30.0])
    assert drive(scene)[0][0] == -6.0


@pytest.mark.parametrize(("timer_s", "lane"), [(1.0, 0), (1.1, 1)])
def test_a_lane_is_considered_only_after_the_lane_change_period(timer_s: float, lane: int) -> None:
    scene = scene_of(
        lanes=2,
        x=[0.0, 30.0],
        y=[0.0, 0.0],
        speed=[25.0, 15.0],
        target_speed=[30.0, 15.0],
        timer_s=[timer_s, 0.0],
    )
    assert drive(scene)[1][0] == lane
    assert scene.timer_s[0, 0] == (0.0 if lane else timer_s)


def test_no_lane_is_taken_whose_follower_would_have_to_brake_hard() -> None:
    scene = scene_of(
        lanes=2,
        x=[100.0, 130.0, 88.0],
        y=[0.0, 0.0, 4.0],
        speed=[25.0, 15.0, 30.0],
        target_speed=[30.0, 15.0, 30.0],
        timer_s=[2.0, 0.0, 0.0],
    )
    assert drive(scene)[1][0] == 0


@pytest.mark.parametrize(("rival_x", "lane"), [(20.0, 0), (-20.0, 1), (120.0, 1)])
def test_a_lane_change_is_aborted_when_another_takes_the_gap_ahead(
    rival_x: float, lane: int
) -> None:
    scene = scene_of(
        x=[0.0, rival_x], y=[0.0, 8.0], speed=[20.0, 20.0], target_lane=[1, 1], timer_s=[0.0, 0.0]
    )
    _, target_lane = IdmMobil().drive(scene.read_only(), (np.array([0]), np.array([0])))
    assert target_lane[0] == lane


@pytest.mark.parametrize(("x", "lanes"), [([20.0, 0.0], [0, 1]), ([0.0, 20.0], [0, 0])])
def test_a_vehicle_sees_the_lane_changes_given_up_by_those_that_acted_before_it(
    x: list[float], lanes: list[int]
) -> None:
    # The wanted gap is 10 m + 20 m/s * 1.5 s: the one at 20 m gives way to the one at 45 m, the one
    # at 0 m only to the one at 20 m.
    scene = scene_of(x=[*x, 45.0], y=[0.0, 0.0, 8.0], speed=[20.0] * 3, target_lane=[1, 1, 1])
    assert list(drive(scene)[1]) == [*lanes, 1]


def test_a_crashed_vehicle_keeps_its_target_lane() -> None:
    scene = scene_of(x=[0.0], y=[0.0], speed=[20.0], target_lane=[1], crashed=[True])
    acceleration, target_lane = drive(scene)
    assert (acceleration[0], target_lane[0]) == (0.0, 1)
