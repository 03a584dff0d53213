import math

import pytest
from handmade_rows import measure, of_paper, of_standard

from charms_bench.world.scene import SceneSettings

NEAR = {"leader_distance": 30.0, "leader_speed": 25.0}


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
