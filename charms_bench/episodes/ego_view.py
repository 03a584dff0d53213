"""The ego's leader, follower, gaps, time to collision and reward over a replay."""

from dataclasses import dataclass

import numpy as np

from charms_bench.envs.highway_reward import highway_reward
from charms_bench.episodes.replay import Replay
from charms_bench.world.gaps import gap_to, is_within, time_to_collision
from charms_bench.world.road import NEIGHBOUR_MARGIN_M, is_on_lane
from charms_bench.world.scene import Bools, Floats, Ints

HAZARD_TTC_S = 6.0
"""A vehicle ahead with a shorter time to collision is a hazard."""
FARTHEST_M = 150.0
ROOM_M = 5.0
"""What a picture shows beyond the centre of a hazard."""


@dataclass(frozen=True)
class EgoView:
    """Arrays [T + 1]; NaN where a quantity does not exist, always so after a collision."""

    leader: Ints
    """Index of the leader; only meaningful where there is one."""
    follower: Ints
    """Index of the follower; only meaningful where there is one."""
    gap_ahead: Floats
    """m, from the ego's front to the rear of the leader on its lane."""
    gap_behind: Floats
    """m, from the follower's front to the ego's rear."""
    ttc: Floats
    """s, to the leader at constant speeds; NaN unless the ego closes in."""
    reward: Floats
    """highway-env's reward of the last complete decision interval."""
    reach_m: float
    """How far ahead of the ego a picture has to reach, to show each hazard on its lane."""


def ego_view(replay: Replay) -> EgoView:
    """Returns what surrounds the ego; leader and follower follow the rule of `Scene.leader`."""
    road, ego, frames = replay.settings.road, replay.ego, np.arange(len(replay.t_s))
    lane = replay.lane[:, [ego]]
    on_lane = is_on_lane(road, lane, replay.x, replay.y, NEIGHBOUR_MARGIN_M)
    on_lane[:, ego] = False
    ahead = replay.x - replay.x[:, [ego]]
    leader, to_leader = _nearest(ahead, on_lane & (ahead >= 0))
    follower, to_follower = _nearest(-ahead, on_lane & (ahead < 0))

    def gap(distance: Floats, other: Ints) -> Floats:
        between = gap_to(distance, replay.length[:, ego], replay.length[frames, other])
        return np.where(~replay.crashed[:, ego] & (between > 0), between, np.nan)

    gap_ahead = gap(to_leader, leader)
    closing = replay.speed[:, ego] - replay.speed[frames, leader]
    return EgoView(
        leader=leader,
        follower=follower,
        gap_ahead=gap_ahead,
        gap_behind=gap(to_follower, follower),
        ttc=time_to_collision(gap_ahead, closing),
        reward=_rewards(replay),
        reach_m=_reach_m(replay, ahead, on_lane & (ahead >= 0)),
    )


def _reach_m(replay: Replay, ahead: Floats, among: Bools) -> float:
    ego = replay.ego
    closing = replay.speed[:, [ego]] - replay.speed
    is_hazard = among & is_within(ahead, closing, HAZARD_TTC_S) & ~replay.crashed[:, [ego]]
    farthest = np.where(is_hazard, ahead, 0.0).max()
    return float(min(farthest + ROOM_M, FARTHEST_M))


def _nearest(distance: Floats, among: Bools) -> tuple[Ints, Floats]:
    """Returns the nearest vehicle [T + 1] and its distance, NaN if there is none."""
    candidates = np.where(among, distance, np.inf)
    nearest = candidates.argmin(axis=1)
    found = candidates[np.arange(len(nearest)), nearest]
    return nearest, np.where(np.isinf(found), np.nan, found)


def _rewards(replay: Replay) -> Floats:
    ego, frames = replay.ego, np.arange(len(replay.t_s))
    at_each = np.vectorize(highway_reward)(
        replay.speed[:, ego] * np.cos(replay.heading[:, ego]),
        replay.target_lane[:, ego],
        replay.crashed[:, ego],
        (frames == frames[-1]) & (replay.ending == "off_road"),
        replay.settings.lanes,
    )
    interval = replay.frame_of(1)
    last: Floats = at_each[frames - frames % interval].copy()
    last[:interval] = np.nan
    return last
