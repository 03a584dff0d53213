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
