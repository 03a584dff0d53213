"""Says in one sentence what happened in a replayed episode.

Vehicles are named by their index in the order of spawning, as in animations and trajectories.
"""

from dataclasses import dataclass

import numpy as np
import polars as pl

from charms_bench.engine.collision_kinds import REAR_END_COS, vehicle_hit
from charms_bench.episodes.criticality import Kind, criticality
from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.metrics.rows import DRIFT_MPS, join_rows
from charms_bench.recording.lane_changes import ATTEMPT_DECISIONS, is_given_up, taker_of
from charms_bench.recording.primitives import NOBODY, VEHICLE
from charms_bench.world.recorded_moments import Moments, moments_of
from charms_bench.world.scene import SceneSettings

CLOSE_M = 1.0
"""A vehicle this close is worth a word: those in the middle of neighbouring lanes of 4 m are 2 m
apart."""


@dataclass(frozen=True)
class AbandonedChange:
    """A lane change that the ego began and abandoned; frames are those of decisions."""

    lane: int
    began: int
    ended: int
    taker: int | None
    """The vehicle that took the gap; see `abandoned_changes`."""


def what_happened(replay: Replay, kind: Kind | None = None, since: int = 1) -> str:
    """Returns one sentence about the most critical event of an episode, or of one kind.

    Events before the decision `since`, at which the episode must still run, are left out. Of an
    episode that starts at a recorded moment, the sentence names the moment.
    """
    words, frame = _event(replay, kind, since)
    if frame is not None:
        words = f"{words}, at t = {replay.t_s[frame]:z.1f} s"
    if replay.settings.is_recorded:
        moments = _moments_of(replay.settings)
        (number,) = moments.numbers_of(np.array([replay.episode], dtype=np.uint64))
        words = f"{words}; starts at {moments.names[number]}"
    return words


def _moments_of(settings: SceneSettings) -> Moments:
    if settings.network is None:
        return moments_of(settings)
    from charms_bench.roads.settings import moments_on  # slow to import

    return moments_on(settings.network)


def critical_time_s(replay: Replay, since: int = 1) -> float:
    """Returns when the most critical event of an episode happens; 0 if there is none."""
    _, frame = _event(replay, None, since)
    return 0.0 if frame is None else float(replay.t_s[frame])


def _event(replay: Replay, kind: Kind | None, since: int) -> tuple[str, int | None]:
    """The most critical event, or the one of a kind, in words, and its frame."""
    if kind is None:
        rows = replay.episodes, replay.steps
        kind = criticality(*rows, replay.settings, since)["kind"].item()
    return {
        "collision": _collision,
        "near-miss": _near_miss,
        "hard-braking": _hard_braking,
        "abandoned-lane-change": _abandoned_change,
    }[kind](replay, since)


def abandoned_changes(replay: Replay) -> list[AbandonedChange]:
    """Returns the lane changes that the ego abandoned before the new lane was its nearest lane.

    The rules are those of `recording.lane_changes`, which counts them at decisions.
    """
    interval = replay.frame_of(1)
    lane, target = (each[::interval, replay.ego] for each in (replay.lane, replay.target_lane))
    wanted = target[:-1]
    given_up = is_given_up(lane[:-1], wanted, lane[1:], target[1:])
    found = []
    for ended in np.nonzero(given_up)[0] + 1:
        lost = int(wanted[ended - 1])
        began = int(np.nonzero(target[:ended] != lost)[0][-1]) + 1
        frames = (began * interval, int(ended) * interval)
        taker = _taker(replay, *frames, lost) if ended - began >= ATTEMPT_DECISIONS else None
        found.append(AbandonedChange(lost, *frames, taker))
    return found


def _taker(replay: Replay, began: int, ended: int, wanted: int) -> int | None:
    now = np.zeros(len(replay.agents), dtype=VEHICLE)
    for name in ("x", "y", "lane", "target_lane"):
        now[name] = getattr(replay, name)[ended]
    now["lost"] = replay.crashed[ended]
    meanwhile = replay.lane[began : ended + 1 : replay.frame_of(1)]
    now["lane_since"] = (meanwhile != wanted).any(axis=0)  # 1 is later than the beginning, 0
    taker = taker_of(replay.settings.road, replay.ego, wanted, 0, now)
    return None if taker == NOBODY else taker


def _abandoned_change(replay: Replay, since: int) -> tuple[str, int | None]:
    start = replay.frame_of(since - 1)
    changes = [change for change in abandoned_changes(replay) if change.ended > start]
    taken = [change for change in changes if change.taker is not None]
    change = max(taken or changes, key=lambda change: change.ended - change.began)
    lasted = replay.t_s[change.ended] - replay.t_s[change.began]
    side = _side(change.lane - int(replay.lane[change.began, replay.ego]))
    words = f"began a lane change to the {side}, abandoned it after {lasted:z.1f} s"
    if change.taker is not None:
        ahead = replay.x[change.ended, change.taker] - replay.x[change.ended, replay.ego]
        where = "ahead" if ahead >= 0 else "behind"
        words += f" when vehicle {change.taker} took the gap, {abs(ahead):z.0f} m {where}"
    return words, change.ended


def _collision(replay: Replay, _: int) -> tuple[str, int | None]:
    ego = replay.ego
    if replay.ending == "off_road":
        return f"left the road at {replay.speed[-1, ego]:z.1f} m/s", -1
    frame = int(replay.crashed[:, ego].argmax())
    x, y, speed = replay.x[frame], replay.y[frame], replay.speed[frame]
    other, _ = vehicle_hit(x, y, replay.length[frame], replay.width[frame], ego)
    faster = speed[ego] - speed[other]
    if replay.ending == "rear_end" and x[other] > x[ego] and -speed[other] > max(speed[ego], 0):
        return f"was hit by vehicle {other}, which reversed at {-speed[other]:z.1f} m/s", frame
    if replay.ending == "rear_end" and x[other] < x[ego] and -speed[ego] > max(speed[other], 0):
        return f"reversed into vehicle {other} at {-speed[ego]:z.1f} m/s", frame
    if replay.ending == "rear_end" and x[other] > x[ego]:
        how = f"at {speed[ego]:z.1f} m/s, {_faster(faster)} than it"
        return f"hit vehicle {other} from behind {how}", frame
    if replay.ending == "rear_end":
        how = f"at {speed[other]:z.1f} m/s, {_faster(-faster)} than the ego"
        return f"was hit from behind by vehicle {other} {how}", frame
    side = _side(y[other] - y[ego])
    turned = replay.heading[frame, other] - replay.heading[frame, ego]
    if np.cos(turned) < -REAR_END_COS:
        how = f"which came the other way at {speed[other]:z.1f} m/s"
        return f"collided with vehicle {other}, {how}", frame
    if np.cos(turned) < REAR_END_COS:
        how = f"which came from the {_side(-np.sin(turned))} at {speed[other]:z.1f} m/s"
        return f"collided with vehicle {other}, {how}", frame
    to_the_right = speed * np.sin(replay.heading[frame])
    towards = np.sign(y[other] - y[ego]) * to_the_right
    if max(towards[ego], -towards[other]) <= DRIFT_MPS:
        return f"clipped vehicle {other} on the {side}, {_faster(faster)} than it", frame
    if towards[ego] >= -towards[other]:
        return f"steered to the {side} into vehicle {other} at {speed[ego]:z.1f} m/s", frame
    how = f"from the {side} at {speed[other]:z.1f} m/s"
    return f"vehicle {other} steered into the ego {how}", frame


def _near_miss(replay: Replay, since: int) -> tuple[str, int | None]:
    rows = join_rows(replay.episodes, replay.steps, replay.settings)
    rows = rows.filter(pl.col("step") >= since)
    if rows["ttc_s"].is_null().all():
        distance, other, frame = _nearest(replay, since)
        if distance < CLOSE_M:
            return f"passed vehicle {other} at a distance of {distance:z.1f} m", frame
        return "never closed in on a vehicle", None
    row = rows.row(int(rows["ttc_s"].arg_min() or 0), named=True)
    frame = replay.frame_of(row["step"])
    distance, other, _ = _nearest(replay, since)
    passed = f"; passed vehicle {other} at a distance of {distance:z.1f} m" * (distance < CLOSE_M)
    return (
        f"TTC {row['ttc_s']:z.1f} s behind vehicle {ego_view(replay).leader[frame]}, "
        f"{_faster(row['speed'] - row['leader_speed'])} than it and {row['gap_m']:z.1f} m away "
        f"(DRAC {row['drac_mps2']:z.1f} m/s²){passed}"
    ), frame


def _nearest(replay: Replay, since: int) -> tuple[float, int, int]:
    """The ego's least distance to a vehicle in any direction, m, which vehicle, and the frame.

    Another vehicle is the rectangle along the ego that contains it. Without vehicles, the distance
    is infinite.
    """
    start, ego = replay.frame_of(since - 1), replay.ego
    at = replay if replay.plan is None else replay.plan
    x, y, heading, long, wide, present = (
        getattr(at, name)[start:] for name in ("x", "y", "heading", "length", "width", "present")
    )
    own = slice(ego, ego + 1)
    cos, sin = np.cos(heading[:, own]), np.sin(heading[:, own])
    turned = heading - heading[:, own]
    forward, sideward = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    dx, dy = x - x[:, own], y - y[:, own]
    along = np.abs(dx * cos + dy * sin) - (long[:, own] + long * forward + wide * sideward) / 2
    across = np.abs(dy * cos - dx * sin) - (wide[:, own] + long * sideward + wide * forward) / 2
    distance = np.where(present, np.hypot(np.maximum(along, 0), np.maximum(across, 0)), np.inf)
    distance[:, ego] = np.inf
    frame, other = np.unravel_index(int(distance.argmin()), distance.shape)
    return float(distance[frame, other]), int(other), start + int(frame)


def _hard_braking(replay: Replay, since: int) -> tuple[str, int | None]:
    rows = join_rows(replay.episodes, replay.steps, replay.settings)
    imposed = rows.select(pl.when(pl.col("step") >= since).then("imposed_braking_mps2"))
    changed = int(imposed.to_series().arg_max() or 0)
    row, before = rows.row(changed, named=True), rows.row(changed - 1, named=True)
    return (
        f"changed to the {_side(row['lane'] - before['lane'])} lane, where the new follower, "
        f"vehicle {row['follower']}, braked at {row['imposed_braking_mps2']:z.1f} m/s²"
    ), replay.frame_of(row["step"])


def _side(to_the_right: float) -> str:
    return "right" if to_the_right > 0 else "left"


def _faster(by: float) -> str:
    return f"{abs(by):z.1f} m/s {'faster' if by >= 0 else 'slower'}"
