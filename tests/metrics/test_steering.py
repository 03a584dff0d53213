from handmade_rows import measure

from charms_bench.metrics.steering import PAPER_YAW_STD

NEAR = {"leader_distance": 30.0, "leader_speed": 25.0}


def test_yaw_std_is_that_of_the_steering_angle() -> None:
    steps = [{"steering": 0.25, **NEAR}, {"steering": -0.25, **NEAR}, {"steering": 1.0}]
    assert measure(PAPER_YAW_STD, ({}, steps)) == 0.25
