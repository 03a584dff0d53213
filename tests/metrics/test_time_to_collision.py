import math

import pytest
from handmade_rows import measure, of_paper, of_standard

from charms_bench.metrics.metric import Metric


def behind(distance: float, closing: float) -> dict[str, float]:
    return {"speed": 30.0, "leader_speed": 30.0 - closing, "leader_distance": distance}


def test_the_papers_ttc_is_measured_between_centres_within_50_m() -> None:
    steps = [
        behind(20.0, 10.0),  # 2 s
        behind(40.0, 10.0),  # 4 s
        behind(40.0, -10.0),  # never
        behind(51.0, 20.0),  # not logged
        {},  # no leader
    ]
    assert measure(of_paper("ttc_below_3s"), ({}, steps)) == pytest.approx(1 / 3)
    assert measure(of_paper("ttc_below_3s_closing"), ({}, steps)) == pytest.approx(1 / 2)


@pytest.mark.parametrize(
    "metric", [of_paper("ttc_below_3s"), of_paper("ttc_below_3s_closing"), of_standard("ttc_min")]
)
def test_without_a_leader_there_is_no_ttc(metric: Metric) -> None:
    assert math.isnan(measure(metric, ({}, [{}, {}])))


def test_a_proportion_among_closing_steps_needs_one() -> None:
    steps = [behind(20.0, 0.0), behind(20.0, -1.0)]
    assert measure(of_paper("ttc_below_3s"), ({}, steps)) == 0.0
    assert math.isnan(measure(of_paper("ttc_below_3s_closing"), ({}, steps)))


def test_exposed_and_integrated_ttc_follow_minderhoud_and_bovy() -> None:
    # Gaps of 25, 10 and 30 m closing at 10 m/s: 2.5, 1 and 3 s, a third of a second each.
    episode = ({}, [behind(30.0, 10.0), behind(15.0, 10.0), behind(35.0, 10.0), {}])
    quiet = ({}, [{}] * 4)
    assert measure(of_standard("ttc_below_3s", ttc_s=3.0), episode, quiet) == pytest.approx(2 / 8)
    assert measure(of_standard("tet", ttc_s=3.0), episode, quiet) == pytest.approx((2 / 3) / 2)
    assert measure(of_standard("tit", ttc_s=3.0), episode, quiet) == pytest.approx(
        (0.5 + 2.0) / 3 / 2
    )


def test_the_smallest_ttc_is_averaged_over_episodes_that_have_one() -> None:
    near = ({}, [behind(25.0, 10.0), behind(17.0, 10.0)])  # 2 s, 1.2 s
    far = ({}, [behind(33.0, 10.0), {}])  # 2.8 s
    assert measure(of_standard("ttc_min"), near, far, ({}, [{}])) == pytest.approx((1.2 + 2.8) / 2)


def test_a_creeping_approach_counts_as_100_s() -> None:
    assert measure(of_standard("ttc_min"), ({}, [behind(45.0, 0.0625)])) == 100.0


def test_the_gap_is_between_the_bumpers_of_vehicles_of_their_own_lengths() -> None:
    # A truck of 16 m, 30.5 m ahead of a car of 5 m, leaves 20 m.
    episode = ({}, [behind(30.5, 10.0) | {"length": 5.0, "leader_length": 16.0}])
    assert measure(of_standard("ttc_min"), episode) == pytest.approx(2.0)


def test_a_wreck_and_a_vehicle_alongside_have_no_ttc() -> None:
    alongside = behind(4.0, 10.0)
    crashed = ({"ending": "rear_end"}, [behind(25.0, 10.0), alongside, behind(6.0, 10.0)])
    assert measure(of_standard("ttc_min"), crashed) == pytest.approx(2.0)
    assert measure(of_standard("ttc_below_3s", ttc_s=3.0), crashed) == pytest.approx(1 / 2)


def test_the_followers_ttc_is_that_of_its_approach_to_the_ego() -> None:
    # At 25 m/s, gaps of 20, 40 and 20 m, closing at 10, 10 and -10 m/s: 2 s, 4 s and never.
    steps = [
        {"follower_distance": 25.0, "follower_speed": 35.0},
        {"follower_distance": 45.0, "follower_speed": 35.0},
        {"follower_distance": 25.0, "follower_speed": 15.0},
        {"follower_distance": 4.0, "follower_speed": 35.0},  # alongside
        {},
    ]
    assert measure(of_standard("rear_ttc_below_3s", ttc_s=3.0), ({}, steps)) == pytest.approx(1 / 5)
    assert measure(of_standard("rear_ttc_below_4_5s", ttc_s=4.5), ({}, steps)) == pytest.approx(
        2 / 5
    )


def test_a_warm_up_has_no_ttc() -> None:
    # Decisions at 1/3, 2/3, 1 and 4/3 s; the first three are up to 1 s.
    steps = [behind(15.0, 10.0), behind(15.0, 10.0), behind(15.0, 10.0), behind(25.0, 10.0)]
    assert measure(of_standard("ttc_min", warm_up_s=1.0), ({}, steps)) == pytest.approx(2.0)
    exposed = of_standard("tet", warm_up_s=1.0, ttc_s=3.0)
    assert measure(exposed, ({}, steps)) == pytest.approx(1 / 3)
    assert of_standard("ttc_below_3s", warm_up_s=1.0).rests_on == "steps after 1 s"
