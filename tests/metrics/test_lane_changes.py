import math

import pytest
from handmade_rows import measure

from charms_bench.metrics.lane_changes import (
    IMPOSED_BRAKING_MEAN,
    LANE_CHANGES_PER_KM,
    imposed_braking_above,
)
from charms_bench.world.scene import SceneSettings


def step(lane: int, follower: float | None = None) -> dict[str, float | None]:
    return {"lane": lane, "follower_acceleration": follower}


def test_lane_changes_are_changes_between_steps_of_an_episode() -> None:
    one = ({"distance_m": 400.0}, [step(0), step(1), step(1), step(0)])
    two = ({"distance_m": 600.0}, [step(2), step(2)])  # starting elsewhere is no change
    assert measure(LANE_CHANGES_PER_KM, one, two) == pytest.approx(2.0)


def test_imposed_braking_is_the_new_followers_strongest_within_2_s() -> None:
    braking = [0.0, -1.0, -3.0, -1.0, 0.0, 0.0]  # 2 s at 3 Hz
    steps = [step(0, -5.0), *(step(1, a) for a in braking), step(1, -6.0)]
    harmless = ({}, [step(0), step(1, 1.0), step(1, 0.5)])
    assert measure(IMPOSED_BRAKING_MEAN, ({}, steps), harmless) == pytest.approx(3.0 / 2)
    assert measure(imposed_braking_above(2.0), ({}, steps), harmless) == pytest.approx(1 / 2)


def test_the_window_is_as_long_at_another_decision_rate() -> None:
    steps = [step(0), step(1, -1.0), step(1, -1.5), step(1, -4.0)]
    slow = SceneSettings(decision_hz=1)
    assert measure(IMPOSED_BRAKING_MEAN, ({}, steps), settings=slow) == 1.5


def test_a_lane_change_before_nobody_imposes_nothing() -> None:
    assert math.isnan(measure(IMPOSED_BRAKING_MEAN, ({}, [step(0), step(1)])))
    assert math.isnan(measure(IMPOSED_BRAKING_MEAN, ({}, [step(0, -1.0), step(0, -1.0)])))
