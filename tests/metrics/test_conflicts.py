"""Conflicts in rows at 3 Hz, in which the ego drives at 30 m/s."""

import math
from typing import Any

import pytest
from handmade_rows import measure, of_standard

NEAR_S, FAR_S = 1.2, 2.0
BEGINNINGS = [
    of_standard(f"conflicts_by_{whom}", conflict_ttc_s=1.5)
    for whom in ("ego", "another", "closing_in")
]


def step(ttc_s: float, leader: int = 4, lane: int = 1) -> dict[str, Any]:
    """A step behind a leader that is 10 m/s slower."""
    return {
        "speed": 30.0,
        "leader": leader,
        "leader_speed": 20.0,
        "leader_distance": 5.0 + 10.0 * ttc_s,
        "lane": lane,
    }


FAR, NEAR = step(FAR_S), step(NEAR_S)


def beginnings(*steps: dict[str, Any]) -> tuple[float, ...]:
    """The proportions by the ego, by another vehicle and by closing in."""
    return tuple(measure(each, ({}, list(steps))) for each in BEGINNINGS)


def rate(*steps: dict[str, Any], warm_up_s: float = 0.0) -> float:
    """Conflicts per 1,000 km, with 100 m between two decisions."""
    rows = [{**row, "x": 100.0 * k} for k, row in enumerate(steps)]
    return measure(
        of_standard("conflicts_per_1000km", warm_up_s=warm_up_s, conflict_ttc_s=1.5), ({}, rows)
    )


def test_a_conflict_lasts_while_the_ttc_to_one_leader_is_below_the_threshold() -> None:
    assert rate(FAR, NEAR, NEAR, NEAR, FAR) == pytest.approx(1 / 400e-6)
    assert rate(FAR, NEAR, FAR, NEAR, NEAR) == pytest.approx(2 / 400e-6)
    assert rate(FAR, NEAR, step(NEAR_S, leader=7), FAR, FAR) == pytest.approx(2 / 400e-6)
    assert rate(FAR, FAR, {}, FAR, FAR) == 0.0


def test_a_conflict_of_the_warm_up_is_not_counted_later() -> None:
    # The first three decisions are up to 1 s; 200 m are driven after them.
    assert rate(FAR, NEAR, NEAR, NEAR, FAR, warm_up_s=1.0) == 0.0
    assert rate(FAR, NEAR, FAR, NEAR, FAR, warm_up_s=1.0) == pytest.approx(1 / 200e-6)


def test_an_episode_has_a_conflict_or_has_none() -> None:
    episodes = ({}, [FAR, NEAR, NEAR]), ({}, [FAR, FAR]), ({"ending": "rear_end"}, [FAR, NEAR])
    assert measure(
        of_standard("conflict_episodes", conflict_ttc_s=1.5), *episodes
    ) == pytest.approx(1 / 3)


def test_the_egos_lane_change_to_behind_a_leader_begins_a_conflict() -> None:
    there = [step(FAR_S, 7, lane=2), step(NEAR_S, 7, lane=2)]
    assert beginnings(FAR, *there) == (1.0, 0.0, 0.0)


def test_a_vehicle_that_cuts_in_begins_a_conflict() -> None:
    assert beginnings(FAR, FAR, step(NEAR_S, leader=7)) == (0.0, 1.0, 0.0)


def test_a_vehicle_that_cuts_out_begins_a_conflict_with_the_next() -> None:
    revealed = [step(FAR_S, leader=9), step(FAR_S, leader=9), step(NEAR_S, leader=9)]
    assert beginnings(FAR, *revealed) == (0.0, 1.0, 0.0)


def test_the_last_lane_change_counts() -> None:
    ours, theirs = step(FAR_S, leader=7, lane=2), step(NEAR_S, leader=8, lane=2)
    assert beginnings(FAR, ours, theirs) == (0.0, 1.0, 0.0)


def test_after_2_s_the_ego_closes_in_on_the_leader_that_it_has() -> None:
    new, close = step(FAR_S, leader=7, lane=2), step(NEAR_S, leader=7, lane=2)
    assert beginnings(FAR, *[new] * 5, close) == (1.0, 0.0, 0.0)  # 5/3 s later
    assert beginnings(FAR, *[new] * 6, close) == (0.0, 0.0, 1.0)  # 2 s later


def test_a_leader_of_the_first_decision_is_nobodys_doing() -> None:
    assert beginnings(NEAR, NEAR) == (0.0, 0.0, 1.0)
    before = ({}, [FAR, step(FAR_S, leader=7)])
    after = ({}, [step(NEAR_S, leader=7)])  # a lane change of the episode before does not count
    proportions = [measure(each, before, after) for each in BEGINNINGS]
    assert proportions == [0.0, 0.0, 1.0]


def test_without_a_conflict_nobody_begins_one() -> None:
    assert all(map(math.isnan, beginnings(FAR, FAR)))
