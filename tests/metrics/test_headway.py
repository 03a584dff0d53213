import math

import pytest
from handmade_rows import DRIVING, measure

from charms_bench.metrics.headway import (
    DHW_MEAN,
    DHW_STD,
    time_headway_below,
    time_headway_mean,
)


def behind(distance: float, speed: float = 25.0) -> dict[str, float]:
    return {"leader_distance": distance, "leader_speed": 25.0, "speed": speed}


def test_distance_headway_is_taken_up_to_50_m() -> None:
    episodes = ({}, [behind(20.0), behind(50.0)]), ({}, [behind(51.0), {}])
    assert measure(DHW_MEAN, *episodes) == 35.0
    assert measure(DHW_STD, *episodes) == 15.0


def test_time_headway_is_that_of_followers() -> None:
    # 0.8 s, 2 s, and with 8 s a free driver.
    steps = [behind(20.0), behind(40.0, speed=20.0), behind(200.0), {}]
    assert measure(time_headway_mean(DRIVING), ({}, steps)) == pytest.approx(1.4)
    assert measure(time_headway_below(DRIVING, 1.0), ({}, steps)) == pytest.approx(1 / 4)


def test_a_standing_vehicle_has_no_time_headway() -> None:
    assert math.isnan(measure(time_headway_mean(DRIVING), ({}, [behind(20.0, speed=0.0)])))
