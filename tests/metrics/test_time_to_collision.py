import math

import pytest
from handmade_rows import measure

from charms_bench.metrics.metric import Metric
from charms_bench.metrics.time_to_collision import (
    PAPER_TTC_BELOW_3S,
    PAPER_TTC_BELOW_3S_CLOSING,
    TTC_MIN,
    conflict_episodes,
    time_exposed,
    time_integrated,
    ttc_below,
)
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import SceneSettings


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
    assert measure(PAPER_TTC_BELOW_3S, ({}, steps)) == pytest.approx(1 / 3)
    assert measure(PAPER_TTC_BELOW_3S_CLOSING, ({}, steps)) == pytest.approx(1 / 2)


@pytest.mark.parametrize("metric", [PAPER_TTC_BELOW_3S, PAPER_TTC_BELOW_3S_CLOSING, TTC_MIN])
def test_without_a_leader_there_is_no_ttc(metric: Metric) -> None:
    assert math.isnan(measure(metric, ({}, [{}, {}])))


def test_a_share_among_closing_steps_needs_one() -> None:
    steps = [behind(20.0, 0.0), behind(20.0, -1.0)]
    assert measure(PAPER_TTC_BELOW_3S, ({}, steps)) == 0.0
    assert math.isnan(measure(PAPER_TTC_BELOW_3S_CLOSING, ({}, steps)))


def test_exposed_and_integrated_ttc_follow_minderhoud_and_bovy() -> None:
    # Gaps of 25, 10 and 30 m closing at 10 m/s: 2.5, 1 and 3 s, a third of a second each.
    episode = ({}, [behind(30.0, 10.0), behind(15.0, 10.0), behind(35.0, 10.0), {}])
    quiet = ({}, [{}] * 4)
    assert measure(ttc_below(3.0), episode, quiet) == pytest.approx(2 / 8)
    assert measure(time_exposed(3.0), episode, quiet) == pytest.approx((2 / 3) / 2)
    assert measure(time_integrated(3.0), episode, quiet) == pytest.approx((0.5 + 2.0) / 3 / 2)


def test_the_smallest_ttc_is_averaged_over_episodes_that_have_one() -> None:
    near = ({}, [behind(25.0, 10.0), behind(17.0, 10.0)])  # 2 s, 1.2 s
    far = ({}, [behind(33.0, 10.0), {}])  # 2.8 s
    assert measure(TTC_MIN, near, far, ({}, [{}])) == pytest.approx((1.2 + 2.8) / 2)
    assert measure(conflict_episodes(1.5), near, far, ({}, [{}])) == pytest.approx(1 / 3)


def test_a_creeping_approach_counts_as_100_s() -> None:
    assert measure(TTC_MIN, ({}, [behind(45.0, 0.0625)])) == 100.0


def test_the_gap_is_shorter_behind_longer_vehicles() -> None:
    settings = SceneSettings(profile=CHARMS.model_copy(update={"vehicle_length_m": 10.0}))
    episode = ({}, [behind(30.0, 10.0)])
    assert measure(TTC_MIN, episode) == pytest.approx(2.5)
    assert measure(TTC_MIN, episode, settings=settings) == pytest.approx(2.0)


def test_a_wreck_and_a_vehicle_alongside_have_no_ttc() -> None:
    alongside = behind(4.0, 10.0)
    crashed = ({"ending": "rear_end"}, [behind(25.0, 10.0), alongside, behind(6.0, 10.0)])
    assert measure(TTC_MIN, crashed) == pytest.approx(2.0)
    assert measure(ttc_below(3.0), crashed) == pytest.approx(1 / 2)
