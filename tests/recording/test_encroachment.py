"""Post-encroachment time in trajectories written by hand; vehicles are 5 m long."""

from typing import Any

import pytest
from handmade_conduct import DT, conduct, only

CUT_IN = [1.0, 4.0]
"""Lateral positions before a cut-in from lane 0; lane 1 begins at 2 m."""
AFTER = [3.0, 4.0]


def pets(sums: dict[str, float], side: str) -> tuple[float, float, float]:
    names = (f"pet_{side}", f"pet_{side}_sum_s", f"pet_below_2s_{side}")
    count, total, short = only(sums, *names).values()
    return count, pytest.approx(total), short


def cut_in(follower: list[float], **fields: Any) -> list[dict[str, float]]:
    """Vehicle 0 changes to lane 1 at decision 1, where its rear is at 47.5 m.

    The fronts of the follower are 2.5 m ahead of its centres.
    """
    ahead = [40.0 + 10.0 * t for t in range(len(follower))]
    x = [list(pair) for pair in zip(ahead, follower, strict=True)]
    given = {"y": [CUT_IN] + [AFTER] * (len(follower) - 1), "speed": 30.0}
    return conduct(x=x, **(given | fields))


def test_pet_is_the_time_until_the_follower_reaches_the_place_that_the_other_left() -> None:
    # The front is at 32.5, 42.5 and 52.5 m: it reaches 47.5 m after 1.5 intervals.
    first, second = cut_in([20.0, 30.0, 40.0, 50.0, 60.0])
    assert pets(first, "by") == pets(second, "to") == (1, 0.5, 1)
    assert pets(first, "to") == pets(second, "by") == (0, 0.0, 0)


def test_a_pet_of_two_seconds_or_more_is_not_short() -> None:
    # The front is at 32.5 m and drives 2.25 m per interval: 15 m take 6.67 intervals.
    _, second = cut_in([30.0 + 2.25 * (t - 1) for t in range(12)])
    assert pets(second, "to") == (1, 20.0 / 9.0, 0)


def test_there_is_no_pet_while_both_overlap() -> None:
    _, second = cut_in([36.0, 46.0, 56.0, 66.0])  # the front is at 48.5 m, beyond the rear
    assert pets(second, "to") == (0, 0.0, 0)


def test_there_is_no_pet_above_five_seconds() -> None:
    _, second = cut_in([30.0 + 0.95 * (t - 1) for t in range(20)])  # 15.8 intervals, 5.26 s
    assert pets(second, "to") == (0, 0.0, 0)
    _, second = cut_in([30.0 + 1.05 * (t - 1) for t in range(20)])  # 14.3 intervals, 4.76 s
    assert pets(second, "to") == (1, 15.0 / 1.05 * DT, 0)


def test_there_is_no_pet_if_the_follower_leaves_the_lane_first() -> None:
    y = [CUT_IN, AFTER, [3.0, 7.0], [3.0, 8.0], [3.0, 8.0]]
    _, second = cut_in([20.0, 30.0, 40.0, 50.0, 60.0], y=y)
    assert pets(second, "to") == (0, 0.0, 0)


def test_there_is_no_pet_if_the_follower_crashes_first() -> None:
    crashed = [[False, False]] * 2 + [[False, True]] * 3
    _, second = cut_in([20.0, 30.0, 40.0, 50.0, 60.0], crashed=crashed, collision=[0, 3])
    assert pets(second, "to") == (0, 0.0, 0)


def test_who_cuts_in_between_is_the_one_that_the_follower_meets() -> None:
    # Vehicle 2 cuts in at decision 2 with its rear at 47.5 m, where the front is at 35.5 m; the
    # front reaches that place after 4 intervals of 3 m.
    follower = [30.0 + 3.0 * (t - 1) for t in range(8)]
    x = [[80.0 + 10.0 * t, back, 40.0 + 5.0 * t] for t, back in enumerate(follower)]
    y = [[1.0, 4.0, 8.0], [3.0, 4.0, 8.0], *[[3.0, 4.0, 5.0]] * 6]
    first, second, between = conduct(x=x, y=y)
    assert pets(first, "by") == (0, 0.0, 0)
    assert pets(between, "by") == pets(second, "to") == (1, 4 * DT, 1)
