"""What happened, in episodes written by hand."""

from typing import Any

import numpy as np
import pytest
from handmade_replay import replay_of

from charms_bench.episodes.what_happened import abandoned_changes, what_happened


def crash(ending: str, ego: dict[str, float], other: dict[str, float]) -> str:
    """The words for a crash in the third simulation step, at 0.2 s."""
    fields: dict[str, Any] = {
        name: np.tile([ego.get(name, 0.0), other.get(name, 0.0)], (5, 1))
        for name in ("x", "y", "heading", "speed")
    }
    crashed = np.zeros((5, 2), dtype=bool)
    crashed[3:] = True
    return what_happened(replay_of(ending, crashed=crashed, **fields))


@pytest.mark.parametrize(
    ("ending", "ego", "other", "words"),
    [
        (
            "rear_end",
            {"speed": 30.0},
            {"x": 4.9, "speed": 22.0},
            "hit vehicle 1 from behind at 30.0 m/s, 8.0 m/s faster than it",
        ),
        (
            "rear_end",
            {"speed": 22.0},
            {"x": -4.9, "speed": 30.0},
            "was hit from behind by vehicle 1 at 30.0 m/s, 8.0 m/s faster than the ego",
        ),
        (
            "side",
            {"speed": 30.0, "heading": 0.05},
            {"x": 1.0, "y": 1.9, "speed": 30.0},
            "steered to the right into vehicle 1 at 30.0 m/s",
        ),
        (
            "side",
            {"speed": 30.0},
            {"x": 1.0, "y": -1.9, "speed": 24.0, "heading": 0.05},
            "vehicle 1 steered into the ego from the left at 24.0 m/s",
        ),
        (
            "side",
            {"speed": 30.0, "heading": 0.05},
            {"x": 4.0, "y": -1.9, "speed": 24.0},
            "clipped vehicle 1 on the left, 6.0 m/s faster than it",
        ),
        (
            "rear_end",
            {"speed": 0.0},
            {"x": 4.9, "speed": -3.0},
            "was hit by vehicle 1, which reversed at 3.0 m/s",
        ),
        (
            "rear_end",
            {"speed": -2.0},
            {"x": -4.9, "speed": 0.0},
            "reversed into vehicle 1 at 2.0 m/s",
        ),
        (
            "side",
            {"speed": 10.0},
            {"x": 3.0, "y": -2.0, "speed": 9.0, "heading": np.pi / 2},
            "collided with vehicle 1, which came from the left at 9.0 m/s",
        ),
        (
            "side",
            {"speed": 10.0},
            {"x": 4.9, "y": 0.5, "speed": 9.0, "heading": np.pi},
            "collided with vehicle 1, which came the other way at 9.0 m/s",
        ),
    ],
)
def test_a_collision_says_who_hit_whom(
    ending: str, ego: dict[str, float], other: dict[str, float], words: str
) -> None:
    assert crash(ending, ego, other) == f"{words}, at t = 0.2 s"


def test_who_leaves_the_road_has_hit_nobody() -> None:
    replay = replay_of("off_road", x=np.zeros((6, 2)), speed=31.0)
    assert what_happened(replay) == "left the road at 31.0 m/s, at t = 0.3 s"


def test_a_near_miss_names_the_leader_at_the_smallest_ttc() -> None:
    x = np.tile([0.0, 10.0, 15.0, 40.0], (11, 1))
    lane = np.tile([1, 0, 1, 1], (11, 1))
    near = {"leader_distance": 15.0, "leader_speed": 15.0}
    replay = replay_of("time", [{}, near], x=x, y=lane * 4.0)
    assert what_happened(replay) == (
        "TTC 1.0 s behind vehicle 2, 10.0 m/s faster than it and 10.0 m away "
        "(DRAC 5.0 m/s²), at t = 0.7 s"
    )


def test_hard_braking_names_the_follower_and_the_side() -> None:
    x = np.tile([100.0, 85.0, 91.0], (11, 1))
    y = np.tile([8.0, 8.0, 4.0], (11, 1))
    changed = {"lane": 2, "follower": 1, "new_follower_acceleration": -4.5}
    later = {"lane": 2, "follower": 2, "follower_acceleration": -8.0}  # it has cut in between
    words = what_happened(replay_of("time", [{}, changed, later], x=x, y=y))
    assert words == (
        "changed to the right lane, where the new follower, vehicle 1, braked at 4.5 m/s², "
        "at t = 0.7 s"
    )


def test_only_events_since_a_decision_are_told() -> None:
    near = {"leader_distance": 15.0, "leader_speed": 15.0}
    later = {"leader_distance": 55.0, "leader_speed": 20.0}
    replay = replay_of("time", [near, {}, later], x=np.tile([0.0, 55.0], (16, 1)), y=4.0)
    assert "TTC 1.0 s" in what_happened(replay)
    assert what_happened(replay, since=2) == (
        "TTC 10.0 s behind vehicle 1, 5.0 m/s faster than it and 50.0 m away (DRAC 0.2 m/s²), "
        "at t = 1.0 s"
    )
    quiet = replay_of("time", [near, {}], x=np.zeros((11, 1)))
    assert what_happened(quiet, since=2) == "never closed in on a vehicle"


def test_a_lane_change_before_the_decision_is_not_told() -> None:
    changed = {"lane": 2, "follower": 1, "new_follower_acceleration": -4.5}
    replay = replay_of("time", [{}, changed, {"lane": 2}], x=np.tile([100.0, 85.0], (16, 1)), y=8.0)
    assert "braked at 4.5 m/s²" in what_happened(replay, since=2)
    assert what_happened(replay, since=3) == "never closed in on a vehicle"
    abandoned = given_up(18.0, 0, 2)
    assert what_happened(abandoned, "abandoned-lane-change", since=3).endswith("at t = 1.0 s")


def test_a_quiet_episode_says_so() -> None:
    assert what_happened(replay_of(x=np.zeros((6, 1)))) == "never closed in on a vehicle"


def frames_of(decisions: Any) -> Any:
    """Values [T + 1, N] at decisions as those at simulation steps, of which a decision has 5."""
    first, *others = decisions
    return np.vstack([[first], np.repeat(others, 5, axis=0)])


def given_up(other_x: float, other_lane: int, comes_at: int, gives_up_at: int = 3) -> Any:
    """The ego, on lane 2, wants lane 1 from decision 1 on; so does the other from `comes_at` on."""
    target = np.tile([2, other_lane], (6, 1))
    target[1:gives_up_at, 0] = 1
    target[comes_at:, 1] = 1
    lane = frames_of(np.tile([2, other_lane], (6, 1)))
    rows = [{"lane": 2, "target_lane": t} for t in (1, 2)]
    x = np.tile([0.0, other_x], (len(lane), 1))
    return replay_of("time", rows, x=x, y=lane * 4.0, target_lane=frames_of(target))


@pytest.mark.parametrize(
    ("other_x", "other_lane", "comes_at", "taker"),
    [
        (18.0, 0, 2, 1),
        (-18.0, 0, 2, 1),
        (18.0, 0, 0, 1),  # it was on its way already
        (18.0, 0, 4, None),  # after the ego gave up
        (18.0, 1, 0, None),  # it was there all the time
        (51.0, 0, 2, None),
    ],
)
def test_the_gap_is_taken_by_who_comes_into_it(
    other_x: float, other_lane: int, comes_at: int, taker: int | None
) -> None:
    (change,) = abandoned_changes(given_up(other_x, other_lane, comes_at))
    assert (change.lane, change.began, change.ended) == (1, 5, 15)
    assert change.taker == taker


def test_an_abandoned_lane_change_is_told() -> None:
    replay = given_up(18.0, 0, 2)
    assert what_happened(replay) == (
        "began a lane change to the left, abandoned it after 0.7 s when vehicle 1 took the gap, "
        "18 m ahead, at t = 1.0 s"
    )
    alone = given_up(51.0, 0, 2)
    assert (
        what_happened(alone)
        == "began a lane change to the left, abandoned it after 0.7 s, at t = 1.0 s"
    )


def test_the_nearest_of_two_decides_whether_the_gap_was_taken() -> None:
    lane = np.tile([2, 0, 1], (6, 1))  # vehicle 2 was on the lane between them all the time
    target = lane.copy()
    target[1:3, 0] = 1
    target[2:, 1] = 1
    x = np.tile([0.0, 30.0, 15.0], (26, 1))
    replay = replay_of(x=x, y=frames_of(lane) * 4.0, target_lane=frames_of(target))
    (change,) = abandoned_changes(replay)
    assert change.taker is None


def test_a_change_taken_back_at_once_loses_no_gap() -> None:
    (change,) = abandoned_changes(given_up(18.0, 0, 1, gives_up_at=2))
    assert change.taker is None


def test_a_vehicle_that_crosses_closely_is_named_although_the_ego_never_closed_in_on_it() -> None:
    # At 0.2 s, the front of the ego, 2.5 m ahead of it, is 0.2 m from the side of the other one.
    x = np.array([[0.0, 3.7]] * 5)
    y = np.array([[0.0, each] for each in (40.0, 20.0, 10.0, 0.0, -10.0)])
    passed = replay_of(x=x, y=y, heading=np.array([0.0, -np.pi / 2]), lane=0)
    words = "passed vehicle 1 at a distance of 0.2 m, at t = 0.2 s"
    assert what_happened(passed, "near-miss") == words


def test_a_vehicle_in_the_neighbouring_lane_is_not_worth_a_word() -> None:
    beside = replay_of(x=np.zeros((5, 2)), y=np.array([0.0, 4.0]))
    assert what_happened(beside, "near-miss") == "never closed in on a vehicle"
