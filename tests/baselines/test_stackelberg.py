"""The Stackelberg game for the lane, against its plain version and by hand."""

import naive
import numpy as np
import pytest
from charms_baselines.stackelberg import Stackelberg
from hypothesis import given, settings
from scenes import all_vehicles, scene_of, scenes

from charms_bench.errors import InputError
from charms_bench.world.scene import Scene


@settings(derandomize=True, deadline=None, max_examples=100)
@given(scenes())
def test_answers_are_those_of_the_plain_version(scene: Scene) -> None:
    acceleration, target_lane = Stackelberg().drive(scene.read_only(), all_vehicles(scene))
    expected = [naive.stackelberg(scene, i) for i in range(scene.x.shape[1])]
    assert list(target_lane) == [lane for _, lane in expected]
    np.testing.assert_allclose(acceleration, [a for a, _ in expected], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("distance", "follower_speed", "lane"),
    [
        (51.0, 33.0, 1),  # further off than 50 m
        (40.0, 10.0, 1),  # within 50 m, but slow: it hardly has to brake
        (20.0, 33.0, 0),  # its best response would cost it more than 1 m/s2
    ],
)
def test_a_roomier_lane_is_entered_when_its_follower_loses_little(
    distance: float, follower_speed: float, lane: int
) -> None:
    scene = scene_of(
        "charms",
        lanes=2,
        x=[100.0, 140.0, 100.0 - distance],
        y=[0.0, 0.0, 4.0],
        speed=[25.0, 25.0, follower_speed],
        target_speed=[33.0, 33.0, 33.0],
    )
    assert Stackelberg().drive(scene.read_only(), all_vehicles(scene))[1][0] == lane


@pytest.mark.parametrize(("gap", "lane"), [(119.0, 0), (121.0, 1)])
def test_a_lane_has_to_promise_a_tenth_more(gap: float, lane: int) -> None:
    scene = scene_of(  # at equal speeds, 0.1 of utility is 20 m of gap
        "charms", lanes=2, x=[0.0, 100.0, gap], y=[0.0, 0.0, 4.0], speed=[25.0] * 3
    )
    assert Stackelberg().drive(scene.read_only(), all_vehicles(scene))[1][0] == lane


def test_acceleration_stays_between_its_bounds() -> None:
    scene = scene_of(
        x=[0.0, 8.0, 500.0], y=[0.0, 0.0, 8.0], speed=[25.0, 0.0, 0.0], target_speed=[30.0] * 3
    )
    acceleration, _ = Stackelberg().drive(scene.read_only(), all_vehicles(scene))
    assert (acceleration[0], acceleration[2]) == (-4.0, 3.0)


def test_a_lane_change_under_way_is_kept() -> None:
    scene = scene_of(x=[0.0, 30.0], y=[0.0, 4.0], speed=[25.0, 10.0], target_lane=[1, 1])
    assert Stackelberg().drive(scene.read_only(), all_vehicles(scene))[1][0] == 1


def test_an_option_of_the_wrong_sign_is_an_input_error() -> None:
    with pytest.raises(InputError, match="stackelberg"):
        Stackelberg(gain=-0.1)
