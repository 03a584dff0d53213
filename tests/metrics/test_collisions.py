import math

import pytest
from handmade_rows import measure, of_paper, of_standard

QUIET = ({"distance_m": 700.0}, [{}] * 6)
REAR_END = ({"ending": "rear_end", "struck": False, "distance_m": 100.0}, [{}] * 2)
OFF_ROAD = ({"ending": "off_road", "distance_m": 200.0}, [{}] * 4)


def test_the_collision_rate_counts_decision_steps() -> None:
    assert measure(of_paper("collision_rate"), QUIET, QUIET, REAR_END, OFF_ROAD) == pytest.approx(
        2 / 18
    )


def test_leaving_the_road_is_a_crash_and_running_out_of_time_is_none() -> None:
    assert measure(of_standard("crashed_episodes"), QUIET, QUIET, OFF_ROAD) == pytest.approx(1 / 3)


def test_an_episode_counts_as_at_fault_only_if_the_ego_crashed_and_was() -> None:
    ours, theirs = (({"ending": "side", "at_fault": fault}, [{}]) for fault in (True, False))
    run = (QUIET, QUIET, ours, theirs)
    assert measure(of_standard("crashed_episodes"), *run) == pytest.approx(2 / 4)
    assert measure(of_standard("crashed_at_fault"), *run) == pytest.approx(1 / 4)


def test_crashes_per_distance_are_those_of_their_kinds_together() -> None:
    run = (QUIET, REAR_END, OFF_ROAD)  # 1 km
    assert measure(of_standard("crashes_per_1000km"), *run) == pytest.approx(2000.0)
    assert measure(of_standard("rear_end_per_1000km"), *run) == pytest.approx(1000.0)
    assert measure(of_standard("side_per_1000km"), *run) == 0.0
    assert measure(of_standard("off_road_per_1000km"), *run) == pytest.approx(1000.0)


def test_traffic_crashes_are_counted_by_vehicle() -> None:
    crashed = ({"traffic_crashed": 3, "traffic_distance_m": 5000.0}, [{}])
    assert measure(of_standard("traffic_crashed"), QUIET, crashed) == pytest.approx(3 / 40)
    assert measure(of_standard("traffic_crashes_per_1000km"), QUIET, crashed) == pytest.approx(
        200.0
    )


def test_without_traffic_its_proportion_of_crashes_is_undefined() -> None:
    alone = ({"traffic_vehicles": 0, "traffic_distance_m": 0.0}, [{}])
    assert math.isnan(measure(of_standard("traffic_crashed"), alone))


def test_rear_ends_are_split_by_who_struck() -> None:
    struck = ({"ending": "rear_end", "struck": True, "distance_m": 100.0}, [{}])
    run = (REAR_END, REAR_END, struck, QUIET)  # 1 km
    assert measure(of_standard("rear_end_striking_per_1000km"), *run) == pytest.approx(2000.0)
    assert measure(of_standard("rear_end_struck_per_1000km"), *run) == pytest.approx(1000.0)
    assert measure(of_standard("rear_end_striking"), *run) == pytest.approx(2 / 3)
    assert math.isnan(measure(of_standard("rear_end_striking"), QUIET, OFF_ROAD))
