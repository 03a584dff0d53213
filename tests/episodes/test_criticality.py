"""Criticality, from rows written by hand."""

from typing import Any

import polars as pl
import pytest
from handmade_replay import replay_of

from charms_bench.episodes.criticality import IS_OF_KIND, criticality

FOLLOWING = {"leader_distance": 20.0, "leader_speed": 15.0}
"""At 25 m/s: a gap of 15 m, 10 m/s faster, TTC 1.5 s, DRAC 10² / 2 / 15 = 3.33 m/s²."""
TO_THE_LEFT, TO_THE_RIGHT = {"target_lane": 0}, {"target_lane": 2}
STAY = {"target_lane": 1}


def measured(*steps: dict[str, Any], ending: str = "time") -> dict[str, Any]:
    replay = replay_of(ending, [STAY | step for step in steps], x=[[0.0]])
    return criticality(replay.episodes, replay.steps, replay.settings).row(0, named=True)


def test_nothing_is_not_critical() -> None:
    row = measured({}, {})
    assert (row["criticality"], row["abandoned_changes"]) == (0.0, 0)
    assert row["ttc_min_s"] is row["drac_max_mps2"] is row["imposed_braking_mps2"] is None


def test_each_measure_is_a_half_at_its_limit() -> None:
    row = measured({}, FOLLOWING)
    assert row["ttc_min_s"] == pytest.approx(1.5)
    drac = 10.0**2 / 2 / 15.0
    assert row["criticality"] == pytest.approx(0.5 + drac / (drac + 3.35))
    assert row["kind"] == "near-miss"


def test_braking_imposed_by_a_lane_change_counts() -> None:
    row = measured({}, {"lane": 2, "target_lane": 2, "new_follower_acceleration": -6.0})
    assert row["imposed_braking_mps2"] == 6.0
    assert row["criticality"] == pytest.approx(6.0 / (6.0 + 2.0))
    assert row["kind"] == "hard-braking"


def test_a_lane_change_given_up_counts() -> None:
    row = measured({}, TO_THE_LEFT, TO_THE_LEFT, STAY)
    assert (row["abandoned_changes"], row["criticality"]) == (1, 0.5)
    assert row["kind"] == "abandoned-lane-change"


def test_two_given_up_are_worse_than_one() -> None:
    row = measured(TO_THE_LEFT, TO_THE_RIGHT, STAY)
    assert (row["abandoned_changes"], row["criticality"]) == (2, pytest.approx(2 / 3))


def test_a_lane_change_that_is_finished_is_not_given_up() -> None:
    there = {"lane": 0, "target_lane": 0}
    assert measured(TO_THE_LEFT, there, there)["abandoned_changes"] == 0
    assert measured(TO_THE_LEFT, there | {"target_lane": 1})["abandoned_changes"] == 0


@pytest.mark.parametrize("ending", ["rear_end", "side", "off_road"])
def test_a_collision_is_worse_than_anything_without_one(ending: str) -> None:
    row = measured({}, ending=ending)
    assert (row["criticality"], row["kind"]) == (4.0, "collision")
    worst = {"leader_distance": 5.01, "leader_speed": 0.0, "new_follower_acceleration": -9.0}
    assert measured({}, TO_THE_LEFT, worst | {"lane": 2})["criticality"] < 4.0


def test_an_episode_may_be_of_several_kinds() -> None:
    near = {"leader_distance": 10.0, "leader_speed": 15.0}
    replay = replay_of("time", [TO_THE_LEFT | near, STAY | near], x=[[0.0]])
    table = criticality(replay.episodes, replay.steps, replay.settings)
    table = table.with_columns(gaps_lost=pl.lit(1))
    kinds = [kind for kind, is_of_kind in IS_OF_KIND.items() if table.filter(is_of_kind).height]
    assert kinds == ["near-miss", "abandoned-lane-change"]
