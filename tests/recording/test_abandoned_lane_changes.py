"""Lane changes, gaps that another vehicle took, and imposed braking, written by hand."""

from typing import Any

import pytest
from handmade_conduct import DT, conduct, only

NAMES = ("abandoned", "gaps_lost", "gaps_taken")


def of(sums: dict[str, float]) -> tuple[float, ...]:
    return tuple(only(sums, *NAMES).values())


def gives_up(other_y: list[float], other_target: list[int], ahead: float = 10.0) -> Any:
    """Vehicle 0 on lane 0 wants lane 1 at decisions 1 and 2, and gives it up at decision 3."""
    return conduct(
        x=[[100.0, 100.0 + ahead]] * 4,
        y=[[0.0, each] for each in other_y],
        target_lane=[
            [wanted, each] for wanted, each in zip((0, 1, 1, 0), other_target, strict=True)
        ],
    )


def test_another_vehicle_takes_the_gap() -> None:
    # As vehicle 4 does in Fig. 4 of the paper: it comes to the middle lane from the other side.
    first, other = gives_up([8.0, 8.0, 7.0, 5.0], [2, 2, 1, 1])
    assert of(first) == (1, 1, 0)
    assert of(other) == (0, 0, 1)


def test_a_vehicle_that_is_still_steering_to_the_gap_takes_it() -> None:
    first, other = gives_up([8.0, 8.0, 8.0, 7.5], [2, 2, 2, 1])
    assert of(first) == (1, 1, 0)
    assert of(other) == (0, 0, 1)


@pytest.mark.parametrize("ahead", [10.0, -10.0])
def test_a_vehicle_that_was_there_before_took_no_gap(ahead: float) -> None:
    first, other = gives_up([4.0] * 4, [1] * 4, ahead)
    assert of(first) == (1, 0, 0)
    assert of(other) == (0, 0, 0)


def test_a_vehicle_far_away_took_no_gap() -> None:
    first, other = gives_up([8.0, 8.0, 7.0, 5.0], [2, 2, 1, 1], ahead=51.0)
    assert of(first) == (1, 0, 0)
    assert of(other) == (0, 0, 0)


def test_a_lane_change_taken_back_at_once_loses_no_gap() -> None:
    first, _ = conduct(
        x=[[100.0, 110.0]] * 4,
        y=[[0.0, 8.0]] * 3 + [[0.0, 7.0]],
        target_lane=[[0, 2], [0, 2], [1, 1], [0, 1]],
    )
    assert of(first) == (1, 0, 0)


def test_a_vehicle_behind_another_one_took_no_gap() -> None:
    first, nearer, farther = conduct(
        x=[[100.0, 110.0, 120.0]] * 4,
        y=[[0.0, 4.0, 8.0]] * 3 + [[0.0, 4.0, 5.0]],
        target_lane=[[0, 1, 2], [1, 1, 2], [1, 1, 1], [0, 1, 1]],
    )
    assert [of(each) for each in (first, nearer, farther)] == [(1, 0, 0), (0, 0, 0), (0, 0, 0)]


def test_a_completed_lane_change_is_not_abandoned() -> None:
    first, _ = conduct(
        x=[[100.0, 300.0]] * 4,
        y=[[0.0, 4.0], [1.0, 4.0], [3.0, 4.0], [4.0, 4.0]],
        target_lane=[[0, 1], [1, 1], [1, 1], [1, 1]],
    )
    assert of(first) == (0, 0, 0)
    assert first["lane_changes"] == 1


@pytest.mark.parametrize(("decision", "counts"), [(1, 1), (6, 1), (7, 0)])
def test_hard_braking_is_imposed_within_two_seconds(decision: int, counts: int) -> None:
    # The lane changes at decision 1, so its two seconds are decisions 1 to 6.
    acceleration = [[0.0, -2.5 if t == decision else -2.0] for t in range(9)]
    first, follower = conduct(
        x=[[100.0, 60.0]] * 9, y=[[1.0, 4.0]] + [[3.0, 4.0]] * 8, acceleration=acceleration
    )
    assert first["hard_braking_by"] == follower["hard_braking_to"] == counts
    assert first["hard_braking_to"] == follower["hard_braking_by"] == 0


def test_one_lane_change_imposes_hard_braking_once() -> None:
    first, follower = conduct(
        x=[[100.0, 60.0]] * 5, y=[[1.0, 4.0]] + [[3.0, 4.0]] * 4, acceleration=[0.0, -3.0]
    )
    assert first["hard_braking_by"] == follower["hard_braking_to"] == 1


def test_hard_braking_is_that_of_the_new_follower_and_of_no_later_one() -> None:
    # Vehicle 2 comes between the two at decision 2, and only one of them brakes at decision 3.
    for braking, counts in (((0.0, -3.0, 0.0), 1), ((0.0, 0.0, -3.0), 0)):
        first, follower, other = conduct(
            x=[[100.0, 60.0, 80.0]] * 6,
            y=[[1.0, 4.0, 8.0], [3.0, 4.0, 8.0]] + [[4.0, 4.0, 5.0]] * 4,
            acceleration=[[0.0] * 3] * 3 + [list(braking)] + [[0.0] * 3] * 2,
        )
        assert first["hard_braking_by"] == counts
        # It is the new follower of vehicle 2, too.
        assert other["hard_braking_by"] == counts
        assert follower["hard_braking_to"] == 2 * counts
        assert other["hard_braking_to"] == 0


def test_two_lane_changes_within_2_s_have_a_new_follower_each() -> None:
    # Vehicle 0 reaches lane 1 at decision 1 and lane 2 at decision 3; both followers brake later.
    first, *followers = conduct(
        x=[[100.0, 60.0, 70.0]] * 6,
        y=[[each, 4.0, 8.0] for each in (1.0, 3.0, 5.0, 7.0, 8.0, 8.0)],
        acceleration=[[0.0] * 3] * 4 + [[0.0, -3.0, -3.0]] * 2,
    )
    assert first["lane_changes"] == first["hard_braking_by"] == 2
    assert [each["hard_braking_to"] for each in followers] == [1, 1]


def test_a_vehicle_counts_until_it_crashes() -> None:
    # Both drive 10 m per decision; they collide in the third.
    striking, struck, left = conduct(
        x=[[10.0 * t, 4.9 + 10.0 * t, 200.0 + 10.0 * t] for t in range(5)],
        y=[[4.0, 4.0, 8.0]] * 2 + [[4.0, 4.0, 8.0], [4.0, 4.0, 10.5], [4.0, 4.0, 8.0]],
        acceleration=[3.0, -2.0, -2.6],
        crashed=[[False] * 3] * 3 + [[True, True, False]] * 2,
        collision=[1, 2, 0],
    )
    names = ("rear_end_striking", "rear_end_struck", "side", "crashed")
    assert list(only(striking, *names).values()) == [1, 0, 0, 1]
    assert list(only(struck, *names).values()) == [0, 1, 0, 1]
    assert list(only(left, *names).values()) == [0, 0, 0, 1]
    for each in (striking, struck, left):
        assert each["distance_m"] == pytest.approx(20.0)
        assert each["time_s"] == pytest.approx(2 * DT)
    assert [each["harsh_s"] for each in (striking, struck, left)] == pytest.approx(
        [2 * DT, 0.0, 2 * DT]
    )
