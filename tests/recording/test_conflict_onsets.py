"""Conflicts and near misses in trajectories written by hand; vehicles are 5 m long."""

import pytest
from handmade_conduct import conduct

Sums = list[dict[str, float]]


def begun(sums: Sums, event: str = "conflicts") -> list[tuple[float, float]]:
    """How often each vehicle began an event, and how often another one did."""
    return [(each[f"{event}_by"], each[f"{event}_to"]) for each in sums]


def test_who_closes_in_begins_the_conflict() -> None:
    # 10 m/s faster, with a gap of 14 m: a TTC of 1.4 s.
    sums = conduct(x=[[0.0, 25.0], [6.0, 25.0]], speed=[30.0, 20.0])
    assert begun(sums) == [(1, 0), (0, 1)]


def test_a_ttc_of_one_and_a_half_seconds_is_no_conflict_yet() -> None:
    # A gap of 6 m closed at 4 m/s, with a DRAC of 1.33 m/s2.
    sums = conduct(x=[[0.0, 15.0], [0.0, 11.0]], speed=[24.0, 20.0])
    assert begun(sums) == begun(sums, "near_misses") == [(0, 0), (0, 0)]


def test_a_leader_that_brakes_begins_the_conflict() -> None:
    sums = conduct(x=[[0.0, 25.0], [6.0, 25.0]], speed=[30.0, 20.0], acceleration=[0.0, -2.1])
    assert begun(sums) == [(0, 1), (1, 0)]


@pytest.mark.parametrize(("decisions_ago", "leader_began"), [(0, True), (6, True), (7, False)])
def test_a_leader_that_entered_the_lane_in_the_last_two_seconds_begins_the_conflict(
    decisions_ago: int, leader_began: bool
) -> None:
    apart = [[0.0, 60.0]] * (decisions_ago + 1)
    y = [[4.0, 1.0]] + [[4.0, 3.0]] * (decisions_ago + 1)
    sums = conduct(x=[*apart, [0.0, 19.0]], y=y, speed=[30.0, 20.0])
    assert begun(sums) == ([(0, 1), (1, 0)] if leader_began else [(1, 0), (0, 1)])


def test_who_changed_lanes_behind_a_slow_vehicle_began_the_conflict_even_if_it_brakes() -> None:
    y = [[1.0, 4.0], [3.0, 4.0]]
    sums = conduct(x=[[0.0, 19.0]] * 2, y=y, speed=[30.0, 20.0], acceleration=[0.0, -3.0])
    assert begun(sums) == [(1, 0), (0, 1)]


def test_a_vehicle_that_steers_into_the_lane_begins_the_conflict_before_it_is_there() -> None:
    # Its centre is 2.8 m beside the middle lane, so it is a neighbour on it.
    target = [[1, 1], [1, 1]]
    fields = {"y": [4.0, 1.2], "speed": [30.0, 20.0]}
    sums = conduct(x=[[0.0, 60.0], [0.0, 19.0]], target_lane=target, **fields)
    assert begun(sums) == [(0, 1), (1, 0)]


def test_a_conflict_counts_again_only_after_it_has_ended() -> None:
    x = [[0.0, 50.0], [0.0, 19.0], [0.0, 18.0], [0.0, 50.0], [0.0, 19.0]]
    sums = conduct(x=x, speed=[30.0, 20.0])
    assert begun(sums) == begun(sums, "near_misses") == [(2, 0), (0, 2)]


def test_a_conflict_that_ends_in_a_collision_is_no_near_miss() -> None:
    x = [[0.0, 50.0], [0.0, 19.0], [0.0, 7.0], [0.0, 5.0]]
    crashed = [[False, False]] * 3 + [[True, True]]
    sums = conduct(x=x, speed=[30.0, 20.0], crashed=crashed, collision=[1, 2])
    assert begun(sums) == [(1, 0), (0, 1)]
    assert begun(sums, "near_misses") == [(0, 0), (0, 0)]


def test_a_large_drac_alone_is_a_near_miss_without_a_conflict() -> None:
    # 12 m/s faster, with a gap of 20 m: a TTC of 1.67 s and a DRAC of 3.6 m/s2.
    sums = conduct(x=[[0.0, 60.0], [0.0, 25.0], [0.0, 60.0]], speed=[32.0, 20.0])
    assert begun(sums) == [(0, 0), (0, 0)]
    assert begun(sums, "near_misses") == [(1, 0), (0, 1)]
