import pytest
from handmade_rows import measure, of_paper, of_standard

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
