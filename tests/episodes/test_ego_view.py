"""What the ego of a replay has around it."""

import numpy as np
from handmade_replay import replay_of

from charms_bench.episodes.ego_view import ego_view


def test_gaps_are_from_bumper_to_bumper_on_the_egos_lane() -> None:
    # Five metres long each: the leader's rear is 30 - 5 m from the ego's front.
    x = [[100.0, 130.0, 80.0, 110.0]]
    view = ego_view(replay_of(x=x, y=[[0.0, 0.0, 0.0, 4.0]]))
    assert view.gap_ahead.tolist() == [25.0]
    assert view.gap_behind.tolist() == [15.0]
    assert (view.leader[0], view.follower[0]) == (1, 2)


def test_time_to_collision_is_the_gap_over_the_closing_speed() -> None:
    replay = replay_of(x=[[0.0, 25.0], [0.0, 25.0]], speed=[[30.0, 20.0], [20.0, 30.0]])
    view = ego_view(replay)
    assert view.ttc[0] == 2.0
    assert np.isnan(view.ttc[1]), "it falls behind"


def test_an_ego_alone_or_wrecked_has_no_gap() -> None:
    alone = ego_view(replay_of(x=[[0.0, 50.0]], y=[[0.0, 8.0]]))
    wrecked = ego_view(replay_of(x=[[0.0, 50.0]], crashed=[[True, False]]))
    for view in (alone, wrecked):
        assert np.isnan([view.gap_ahead, view.gap_behind, view.ttc]).all()


def test_the_reward_is_highway_envs_of_the_last_decision() -> None:
    # Five simulation steps a decision. Leftmost of three lanes at 25 m/s: 0.4 * 0.5 = 0.2, from
    # [-1, 0.5] onto [0, 1]: (0.2 + 1) / 1.5 = 0.8. Then 30 m/s: (0.4 + 1) / 1.5.
    speed = np.full((8, 2), 25.0)
    speed[6:] = 30.0
    view = ego_view(replay_of(x=np.zeros((8, 2)), speed=speed))
    assert np.isnan(view.reward[:5]).all()
    np.testing.assert_allclose(view.reward[5:], [0.8, 0.8, 0.8])


def test_a_picture_reaches_a_stationary_vehicle_that_a_leader_still_hides() -> None:
    # From 90 m at 25 m/s, the collision is 3.6 s away; the vehicle at 100 m is on another lane.
    view = ego_view(
        replay_of(
            x=[[0.0, 40.0, 90.0, 100.0]], y=[[4.0, 4.0, 4.0, 0.0]], speed=[[25.0, 25.0, 0.0, 0.0]]
        )
    )
    assert view.gap_ahead.tolist() == [35.0]
    assert 90.0 < view.reach_m < 100.0
    calm = ego_view(replay_of(x=[[0.0, 40.0]], y=[[4.0, 4.0]], speed=[[25.0, 25.0]]))
    assert calm.reach_m < 40.0
