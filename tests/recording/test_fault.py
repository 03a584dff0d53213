"""Who is at fault, in collisions written by hand: 3 decisions per second, lanes of 4 m."""

from typing import Any

import numpy as np
import pytest
from handmade_conduct import conduct

STRIKING, STRUCK, SIDE = 1, 2, 3
AHEAD = np.arange(12.0)
LANE_0, LANE_1, LANE_2 = 0.0, 4.0, 8.0


def judged(kind: int, x: Any, y: Any, speed: Any, **fields: Any) -> tuple[float, float]:
    """Whether each of two vehicles is at fault; they collide in the last decision interval.

    Vehicle 0 collides as `kind` says, and vehicle 1 as its counterpart.
    """
    shape = np.shape(x)
    crashed, collision = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=int)
    crashed[-1], collision[-1] = True, (kind, {1: 2, 2: 1, 3: 3}[kind])
    y = np.broadcast_to(y, shape)
    heading = np.zeros(shape)
    # As fast across the road as the next change of y, or as the last one.
    lateral = np.diff(y, axis=0) * 3
    heading[:-1], heading[-1] = lateral / 25, lateral[-1] / 25
    first, second = conduct(
        x=x, y=y, speed=speed, heading=heading, crashed=crashed, collision=collision, **fields
    )
    assert first["crashed"] == second["crashed"] == 1
    return first["at_fault"], second["at_fault"]


def following(gaps: list[float]) -> list[list[float]]:
    """Places of a vehicle and of its leader, by the gaps between bumpers at decisions."""
    return [[100.0, 105.0 + gap] for gap in gaps]


def test_who_strikes_a_leader_is_at_fault_however_hard_the_leader_brakes() -> None:
    x = following([4.0, 2.0, -0.1])
    assert judged(STRIKING, x, LANE_1, [30.0, 24.0], acceleration=[0.0, -9.0]) == (1, 0)


# The intruder comes from lane 0; its side crosses the marking, at y = 2, between the first two
# decisions. It is 6 m/s slower: the follower needs 6² / 2 / 5 = 3.6 m/s² for 5 m.
INTRUDER = [0.5, 1.5, 2.5, 3.5]


@pytest.mark.parametrize(
    ("gap", "waits", "expected"),
    [
        (5.0, 0, (0, 1)),
        (5.4, 0, (1, 0)),  # 3.33 m/s²
        (5.0, 4, (0, 1)),  # struck 6 decisions after the entry, which are 2 s
        (5.0, 5, (1, 0)),
    ],
)
def test_who_cuts_in_too_closely_is_at_fault_for_2_s(
    gap: float, waits: int, expected: tuple[int, int]
) -> None:
    y = [[LANE_1, each] for each in [*INTRUDER, *[LANE_1] * waits]]
    x = following([gap + 2.0, *[gap] * (2 + waits), -0.1])
    assert judged(STRIKING, x, y, [30.0, 24.0]) == expected


@pytest.mark.parametrize(
    ("gaps", "expected"),
    [
        ([7.0, 6.6, 6.2, 5.6, 5.0], (1, 0)),  # 2.6 m/s² at the crossing, 3.6 at the decision
        ([5.0, 5.2, 5.4, 5.8, 6.0], (0, 1)),  # 3.6 m/s² at the crossing, 3.0 at the decision
    ],
)
def test_an_entry_is_judged_in_the_simulation_step_of_the_crossing(
    gaps: list[float], expected: tuple[int, int]
) -> None:
    y = [[LANE_1, each] for each in (0.9, 1.1, 1.2, 1.3, 1.4, 1.5, 2.2, 2.6, 3.0, 3.4, 3.8)]
    x = following([8.0, *gaps, 4.0, 3.0, 2.0, 1.0, -0.1])
    assert judged(STRIKING, x, y, [30.0, 24.0], every=5) == expected


def test_a_vehicle_that_comes_to_the_lane_later_is_not_cut_in_on() -> None:
    # Both come to lane 1, the vehicle ahead first.
    y = [[LANE_2, 0.5], [LANE_2, 1.5], [7.0, 2.5], [5.5, 3.5], [4.5, 4.0]]
    assert judged(STRIKING, following([7.0, 5.0, 4.0, 2.0, -0.1]), y, [30.0, 24.0]) == (1, 0)


def test_in_a_side_collision_the_last_to_move_out_of_its_lane_is_at_fault() -> None:
    x = [[100.0, 101.0]] * 6
    alone = [[LANE_1, each] for each in (0.0, 0.0, 0.5, 1.0, 1.6, 2.1)]
    assert judged(SIDE, x, alone, 25.0) == (0, 1)
    # Both come to lane 1; the first one begins a decision later.
    both = [[8.0, 0.0], [8.0, 0.0], [8.0, 0.6], [7.0, 1.2], [6.0, 2.0], [5.0, 3.0]]
    assert judged(SIDE, x, both, 25.0) == (1, 0)


def test_both_are_at_fault_if_they_move_out_in_the_same_interval() -> None:
    y = [[8.0, 0.0], [8.0, 0.0], [7.4, 0.6], [6.6, 1.4], [5.8, 2.2], [4.9, 3.1]]
    assert judged(SIDE, [[100.0, 101.0]] * 6, y, 25.0) == (1, 1)


def test_who_steers_back_does_not_move_out_of_its_lane() -> None:
    # The second begins later, but the first one's way back to its lane begins last.
    back = [LANE_1, 4.6, 5.0, 4.9, 4.6, 4.4]
    y = list(zip(back, [8.0, 8.0, 8.0, 7.5, 6.9, 6.3], strict=True))
    assert judged(SIDE, [[100.0, 101.0]] * 6, y, 25.0) == (0, 1)


def test_who_is_hit_by_a_slower_vehicle_behind_has_come_from_the_side() -> None:
    # It moves into the lane just ahead of the other one, which it overtakes.
    y = [[each, LANE_1] for each in (0.0, 0.5, 1.2, 2.0, 2.4)]
    x = [[100.0 + 2 * t, 97.3] for t in range(5)]
    assert judged(STRUCK, x, y, [27.0, 24.0]) == (1, 0)


def test_who_leaves_the_road_is_at_fault() -> None:
    x = [[100.0, 300.0]] * 3
    left, _ = conduct(x=x, y=[[8.0, 4.0], [9.0, 4.0], [10.1, 4.0]])
    assert (left["crashed"], left["at_fault"]) == (1, 1)


def test_a_wreck_that_is_hit_again_keeps_its_first_verdict() -> None:
    x = [[100.0, 110.0, 70.0], [104.9, 109.8, 90.0], [104.9, 109.8, 100.0]]
    collision = [[0, 0, 0], [STRIKING, STRUCK, 0], [STRIKING, STRUCK, STRIKING]]
    crashed = np.array(collision) > 0
    rows = conduct(x=x, speed=[30.0, 24.0, 30.0], crashed=crashed, collision=collision)
    assert [row["at_fault"] for row in rows] == [1, 0, 1]
    assert [row["crashed"] for row in rows] == [1, 1, 1]
