"""How fast the ego drives and how smoothly; of the set `paper`, only with a leader near."""

import math

import pytest
from handmade_rows import measure, of_paper, of_standard

from charms_bench.world.scene import SceneSettings

NEAR = {"leader_distance": 30.0, "leader_speed": 25.0}


def test_the_paper_takes_speed_only_behind_a_leader() -> None:
    steps = [{"speed": 22.0, **NEAR}, {"speed": 26.0, **NEAR}, {"speed": 33.0}]
    assert measure(of_paper("speed_mean"), ({}, steps)) == 24.0
    assert measure(of_paper("speed_std"), ({}, steps)) == 2.0
    assert measure(of_standard("speed_mean"), ({}, steps)) == 27.0


def test_a_constant_speed_has_no_deviation() -> None:
    assert measure(of_paper("speed_std"), ({}, [{"speed": 25.3, **NEAR}] * 7)) == 0.0


def test_a_wreck_has_no_speed() -> None:
    steps = [{"speed": 30.0}, {"speed": 10.0}]
    assert measure(of_standard("speed_mean"), ({"ending": "side"}, steps)) == 30.0
    assert measure(of_standard("speed_mean"), ({"ending": "off_road"}, steps)) == 20.0


def test_the_traffics_speed_is_distance_over_time() -> None:
    one = ({"traffic_vehicles": 2, "duration_s": 20.0, "traffic_distance_m": 1000.0}, [{}])
    two = ({"traffic_vehicles": 2, "duration_s": 5.0, "traffic_distance_m": 150.0}, [{}])
    assert measure(of_standard("traffic_speed_mean"), one, two) == pytest.approx(1150 / 50)


def test_the_papers_mean_acceleration_leaves_braking_out() -> None:
    steps = [{"acceleration": a, **NEAR} for a in (1.0, 2.0, 0.0, -4.0)] + [{"acceleration": 6.0}]
    assert measure(of_paper("acc_mean"), ({}, steps)) == 1.5
    assert measure(of_paper("acc_std"), ({}, steps)) == pytest.approx(math.sqrt(21 / 4 - 1 / 16))


def test_harsh_is_more_than_2_5_either_way() -> None:
    steps = [{"acceleration": a, **NEAR} for a in (2.5, 2.75, -2.75, 0.0)]
    assert measure(of_paper("harsh_acc_rate"), ({}, steps)) == pytest.approx(2 / 4)


def test_the_papers_harsh_rate_has_two_denominators() -> None:
    wreck = ({"ending": "rear_end"}, [{"acceleration": 1.0, **NEAR}, {"acceleration": -5.0}])
    free = ({}, [{"acceleration": 3.0, **NEAR}, {}, {}])
    assert measure(of_paper("harsh_acc_rate"), wreck, free) == pytest.approx(1 / 2)
    assert measure(of_paper("harsh_acc_rate_all_steps"), wreck, free) == pytest.approx(2 / 5)


def test_neither_the_warm_up_nor_the_braking_of_a_wreck_is_harsh() -> None:
    steps = [{"acceleration": a} for a in (-5.0, -5.0, -5.0, 3.0, 0.0, -5.0)]
    wreck = ({"ending": "rear_end"}, steps)
    assert measure(of_standard("harsh_acc_rate"), wreck) == pytest.approx(4 / 5)
    assert measure(of_standard("harsh_acc_rate", warm_up_s=1.0), wreck) == pytest.approx(1 / 2)


def test_only_braking_has_no_mean_of_positive_accelerations() -> None:
    assert math.isnan(measure(of_paper("acc_mean"), ({}, [{"acceleration": -1.0, **NEAR}])))


def test_the_standard_deviation_ends_with_a_collision() -> None:
    steps = [{"acceleration": a} for a in (1.0, 3.0, -30.0)]
    assert measure(of_standard("acc_std"), ({"ending": "rear_end"}, steps)) == 1.0


def test_jerk_is_the_difference_over_the_decision_interval() -> None:
    episode = ({}, [{"acceleration": a} for a in (0.0, 1.0, -1.0)])
    other = ({}, [{"acceleration": 6.0}])  # no pair, and none across episodes
    assert measure(of_standard("jerk_rms"), episode, other) == pytest.approx(
        math.sqrt((3.0**2 + 6.0**2) / 2)
    )
    slow = SceneSettings(decision_hz=1)
    assert measure(of_standard("jerk_rms"), episode, settings=slow) == pytest.approx(
        math.sqrt((1.0 + 4.0) / 2)
    )


def test_yaw_std_is_that_of_the_steering_angle() -> None:
    steps = [{"steering": 0.25, **NEAR}, {"steering": -0.25, **NEAR}, {"steering": 1.0}]
    assert measure(of_paper("yaw_std"), ({}, steps)) == 0.25


def test_the_yaw_rate_is_the_change_of_heading_over_the_decision_interval() -> None:
    # At 3 Hz: 0.03 and -0.06 rad/s; the next change is that of a wreck.
    steps = [{"heading": h} for h in (0.01, 0.02, 0.0, 0.5)]
    other = ({}, [{"heading": 0.3}])  # no pair, and none across episodes
    found = measure(of_standard("yaw_rate_rms"), ({"ending": "side"}, steps), other)
    assert found == pytest.approx(math.sqrt((0.03**2 + 0.06**2) / 2), rel=1e-6)


def test_interaction_density_is_taken_in_logged_steps() -> None:
    steps = [{"vehicles_near": 4, **NEAR}, {"vehicles_near": 1, **NEAR}, {"vehicles_near": 9}]
    assert measure(of_paper("interaction_density"), ({}, steps)) == 2.5
