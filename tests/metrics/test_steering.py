import math

import pytest
from handmade_rows import measure, of_paper, of_standard

NEAR = {"leader_distance": 30.0, "leader_speed": 25.0}


def test_yaw_std_is_that_of_the_steering_angle() -> None:
    steps = [{"steering": 0.25, **NEAR}, {"steering": -0.25, **NEAR}, {"steering": 1.0}]
    assert measure(of_paper("yaw_std"), ({}, steps)) == 0.25


def test_the_yaw_rate_is_the_change_of_heading_over_the_decision_interval() -> None:
    # At 3 Hz: 0.03 and -0.06 rad/s; the next change is that of a wreck.
    steps = [{"heading": h} for h in (0.01, 0.02, 0.0, 0.5)]
    other = ({}, [{"heading": 0.3}])  # no pair, and none across episodes
    found = measure(of_standard("yaw_rate_rms"), ({"ending": "side"}, steps), other)
    assert found == pytest.approx(math.sqrt((0.03**2 + 0.06**2) / 2), rel=1e-6)
