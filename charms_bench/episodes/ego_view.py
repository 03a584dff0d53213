"""What the ego of a replay has around it at every simulation step."""

from dataclasses import dataclass

import numpy as np

from charms_bench.envs.highway_reward import highway_reward
from charms_bench.episodes.replay import Replay
from charms_bench.world.lanes import is_on_lane
from charms_bench.world.scene import Bools, Floats, Ints


@dataclass(frozen=True)
class EgoView:
    """[T + 1] each; NaN where there is none, as from a collision on."""

    leader: Ints
    """Its place, only meaningful where there is a gap ahead."""
    follower: Ints
    gap_ahead: Floats
    """m, from the ego's front to the rear of the leader on its lane."""
    gap_behind: Floats
    """m, from the follower's front to the ego's rear."""
    ttc: Floats
    """s, to the leader at constant speeds; NaN unless the ego closes in."""
    reward: Floats
    """highway-env's, of the decision interval that ended last; NaN before the first has."""


def ego_view(replay: Replay) -> EgoView:
    """Looks around; the same vehicles as `Scene.leader` and `Scene.follower` find."""
    profile, ego = replay.settings.profile, replay.ego
    constants = replay.settings.constants
    on_lane = is_on_lane(replay.x, replay.y, replay.lane[:, [ego]], constants)
    on_lane[:, ego] = False
    ahead = replay.x - replay.x[:, [ego]]
    driving = ~replay.crashed[:, ego]
    leader, to_leader = _nearest(ahead, on_lane & (ahead >= 0))
    follower, to_follower = _nearest(-ahead, on_lane & (ahead < 0))
    closing = replay.speed[:, ego] - replay.speed[np.arange(len(leader)), leader]
    gap = _gap(to_leader, driving, profile.vehicle_length_m)
    ttc = np.full(gap.shape, np.nan)
    np.divide(gap, closing, out=ttc, where=closing > 0)
    return EgoView(
        leader=leader,
        follower=follower,
        gap_ahead=gap,
        gap_behind=_gap(to_follower, driving, profile.vehicle_length_m),
        ttc=ttc,
        reward=_rewards(replay),
    )


def _nearest(distance: Floats, among: Bools) -> tuple[Ints, Floats]:
    """The nearest vehicle [T + 1], and its distance; NaN where there is none."""
    candidates = np.where(among, distance, np.inf)
    nearest = candidates.argmin(axis=1)
    found = candidates[np.arange(len(nearest)), nearest]
    return nearest, np.where(np.isinf(found), np.nan, found)


def _gap(distance: Floats, driving: Bools, length: float) -> Floats:
    gap: Floats = np.where(driving & (distance > length), distance - length, np.nan)
    return gap


def _rewards(replay: Replay) -> Floats:
    ego, frames = replay.ego, np.arange(len(replay.t_s))
    off_road = (frames == frames[-1]) & (replay.ending == "off_road")
    at_each = highway_reward(
        forward=replay.speed[:, ego] * np.cos(replay.heading[:, ego]),
        target_lane=replay.target_lane[:, ego],
        crashed=replay.crashed[:, ego],
        off_road=off_road,
        lanes=replay.settings.lanes,
    )
    interval = replay.frame_of(1)
    last: Floats = at_each[frames - frames % interval].copy()
    last[:interval] = np.nan
    return last
