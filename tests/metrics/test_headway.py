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


def test_a_stationary_vehicle_has_no_time_headway() -> None:
    assert math.isnan(measure(of_standard("time_headway_mean"), ({}, [behind(20.0, speed=0.0)])))


def test_headway_between_centres_is_that_of_leaders_within_100_m() -> None:
    # 0.8 s, 1 s, 0.9 s and 4 s; a leader beyond 100 m and a road without one do not count.
    steps = [behind(20.0), behind(25.0), behind(18.0, speed=20.0), behind(100.0), behind(101.0), {}]
    short = of_standard("centre_headway_below_1s")
    assert measure(short, ({}, steps)) == pytest.approx(2 / 4)
    longer = of_standard("centre_headway_below_1_5s", headway_s=1.5)
    assert measure(longer, ({}, steps)) == pytest.approx(3 / 4)
    assert measure(short, ({}, [behind(2.0, speed=0.0)])) == 0.0
    assert math.isnan(measure(short, ({}, [{}])))
    # A leader beside the ego has no gap, but its centre is near.
    assert measure(short, ({}, [behind(4.0)])) == 1.0


CLOSING = "closing_speed_below_1s_mean"


def closing(distance: float, by: float, leader: int = 1) -> dict[str, float]:
    """A step at 25 m/s behind a leader that is slower by some speed; 25 m are 1 s."""
    return {"leader": leader, **behind(distance), "leader_speed": 25.0 - by}


def test_closing_speed_is_that_of_decisions_at_which_the_headway_falls_below_1_s() -> None:
    # The second step and the last one; the leader of the last one is faster.
    steps = [closing(25.0, 3.0), closing(24.0, 3.0), closing(23.0, 2.0), closing(25.0, -1.0)]
    steps += [closing(24.0, -1.0)]
    assert measure(of_standard(CLOSING), ({}, steps)) == pytest.approx(3.0 / 2)
    at_1_5_s = of_standard("closing_speed_below_1_5s_mean", headway_s=1.5)
    assert measure(at_1_5_s, ({}, [closing(38.0, 2.0), *steps])) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("before", "mean"),
    [
        ({}, 4.0),  # no leader
        (closing(30.0, 1.0, leader=2), math.nan),  # another one cut in, or left
        (closing(4.0, 1.0), math.nan),  # beside the ego, so without a headway
    ],
)
def test_a_headway_that_jumps_to_another_leader_does_not_fall(
    before: dict[str, float], mean: float
) -> None:
    found = measure(of_standard(CLOSING), ({}, [before, closing(20.0, 4.0)]))
    assert found == pytest.approx(mean, nan_ok=True)


def test_the_first_decision_a_warm_up_and_a_wreck_have_no_falling_headway() -> None:
    falls = [closing(26.0, 4.0), closing(24.0, 4.0)]
    assert math.isnan(measure(of_standard(CLOSING), ({}, falls[:1]), ({}, falls[1:])))
    assert math.isnan(measure(of_standard(CLOSING, warm_up_s=1.0), ({}, falls)))
    # The second decision, at 2/3 s, is the first one after 0.5 s.
    assert measure(of_standard(CLOSING, warm_up_s=0.5), ({}, falls)) == pytest.approx(4.0)
    assert math.isnan(measure(of_standard(CLOSING), ({"ending": "rear_end"}, falls)))
