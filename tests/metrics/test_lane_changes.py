import math
from typing import Any

import numpy as np
import pytest
from handmade_rows import measure, of_standard


def step(lane: int, new_follower: float | None = None) -> dict[str, float | None]:
    return {"lane": lane, "new_follower_acceleration": new_follower}


def test_lane_changes_are_changes_between_steps_of_an_episode() -> None:
    # 100 m between two decisions.
    one = ({}, [{"x": 100.0 * k, **step(lane)} for k, lane in enumerate((0, 1, 1, 0))])
    two = ({}, [{"x": 0.0, **step(2)}, {"x": 100.0, **step(2)}])  # starting elsewhere is no change
    assert measure(of_standard("lane_changes_per_km"), one, two) == pytest.approx(2 / 0.4)


def test_lane_changes_of_a_warm_up_and_of_a_wreck_do_not_count() -> None:
    lanes = (0, 1, 1, 0, 0, 1)
    rows = [{"x": 100.0 * k, **step(lane)} for k, lane in enumerate(lanes)]
    after_1_s = of_standard("lane_changes_per_km", warm_up_s=1.0)
    assert measure(after_1_s, ({}, rows)) == pytest.approx(2 / 0.3)
    assert measure(after_1_s, ({"ending": "side"}, rows)) == pytest.approx(1 / 0.2)


def test_accepted_gaps_are_those_between_bumpers_on_the_new_lane() -> None:
    near = {"leader_distance": 25.0, "follower_distance": 15.0}
    steps = [
        {"lane": 0, "leader_distance": 90.0, "follower_distance": 90.0},
        {"lane": 1, **near},  # gaps of 20 and 10 m
        {"lane": 1, "leader_distance": 70.0, "follower_distance": 70.0},
        {"lane": 2, "leader_distance": 45.0},  # a gap of 40 m, and no follower
    ]
    beside = ({}, [{"lane": 2}, {"lane": 1, "follower_distance": 4.0}])  # bumpers overlap
    assert measure(of_standard("lead_gap_mean"), ({}, steps), beside) == pytest.approx(30.0)
    assert measure(of_standard("lag_gap_mean"), ({}, steps), beside) == pytest.approx(5.0)
    assert math.isnan(measure(of_standard("lag_gap_mean"), ({}, [{"lane": 1}] * 3)))


def drifting(lateral_mps: list[float], lanes: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """An episode at 25 m/s with these lateral speeds and lanes."""
    headings = np.arcsin(np.array(lateral_mps) / 25.0)
    return {}, [
        {"heading": float(h), "lane": int(lane)} for h, lane in zip(headings, lanes, strict=True)
    ]


def test_a_lane_change_lasts_from_the_start_to_the_end_of_lateral_movement() -> None:
    # Faster than 0.1 m/s across the road at the 2nd to the 7th decision: 6 / 3 s.
    one = drifting([0.0, 0.2, 1.0, 1.5, 1.0, 0.5, 0.2, 0.05, 0.0], "000111111")
    other = drifting([0.0, -0.5, -1.0, -1.0, 0.0], "22111")  # 1 s, to the left
    assert measure(of_standard("lane_change_duration_mean"), one, other) == pytest.approx(1.5)


def test_two_lane_changes_in_one_movement_take_half_of_it_each() -> None:
    both = drifting([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0], "00011222")  # 2 s
    assert measure(of_standard("lane_change_duration_mean"), both) == pytest.approx(1.0)


def test_movements_without_a_lane_change_or_without_an_end_have_no_duration() -> None:
    abandoned = drifting([0.0, 0.5, 0.3, -0.3, -0.5, 0.0], "111111")
    unfinished = drifting([0.0, 0.5, 1.0, 1.0], "0011")
    crashed = drifting([0.0, 0.5, 1.0, 0.0], "0011")
    metric = of_standard("lane_change_duration_mean")
    assert math.isnan(measure(metric, abandoned, unfinished, ({"ending": "side"}, crashed[1])))


def test_imposed_braking_is_the_new_followers_strongest() -> None:
    braked = ({}, [step(0), step(1, -3.0), {**step(1), "follower_acceleration": -6.0}])
    harmless = ({}, [step(0), step(1, 1.0), step(1)])
    assert measure(of_standard("imposed_braking_mean"), braked, harmless) == pytest.approx(3.0 / 2)
    assert measure(
        of_standard("imposed_braking_above_2", imposed_mps2=2.0), braked, harmless
    ) == pytest.approx(1 / 2)


def test_a_lane_change_before_nobody_imposes_nothing() -> None:
    assert math.isnan(measure(of_standard("imposed_braking_mean"), ({}, [step(0), step(1)])))
    stays = ({}, [step(0, -1.0), step(0, -1.0)])
    assert math.isnan(measure(of_standard("imposed_braking_mean"), stays))
