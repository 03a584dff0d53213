import math

import pytest
from handmade_rows import measure, of_paper, of_standard


def behind(distance: float, speed: float = 25.0) -> dict[str, float]:
    return {"leader_distance": distance, "leader_speed": 25.0, "speed": speed}


def test_distance_headway_is_taken_up_to_50_m() -> None:
    episodes = ({}, [behind(20.0), behind(50.0)]), ({}, [behind(51.0), {}])
    assert measure(of_paper("dhw_mean"), *episodes) == 35.0
    assert measure(of_paper("dhw_std"), *episodes) == 15.0


def test_time_headway_is_that_of_followers() -> None:
    # 0.8 s, 2 s, and with 8 s a free driver.
    steps = [behind(20.0), behind(40.0, speed=20.0), behind(200.0), {}]
    assert measure(of_standard("time_headway_mean"), ({}, steps)) == pytest.approx(1.4)
    assert measure(
        of_standard("time_headway_below_1s", headway_s=1.0), ({}, steps)
    ) == pytest.approx(1 / 4)


def test_a_standing_vehicle_has_no_time_headway() -> None:
    assert math.isnan(measure(of_standard("time_headway_mean"), ({}, [behind(20.0, speed=0.0)])))


def test_headway_between_centres_is_that_of_leaders_within_100_m() -> None:
    # 0.8 s, 1 s, 0.9 s and 4 s; a leader beyond 100 m and a road without one do not count.
    steps = [behind(20.0), behind(25.0), behind(18.0, speed=20.0), behind(100.0), behind(101.0), {}]
    short = of_standard("centre_headway_below_1s")
    assert measure(short, ({}, steps)) == pytest.approx(2 / 4)
    longer = of_standard("centre_headway_below_1_5s", headway_s=1.5)
    assert measure(longer, ({}, steps)) == pytest.approx(3 / 4)
    assert measure(short, ({}, [behind(2.0, speed=0.0)])) == 0.0
    assert math.isnan(measure(short, ({}, [{}])))
    # A leader beside the ego has no gap, but its centre is near.
    assert measure(short, ({}, [behind(4.0)])) == 1.0
