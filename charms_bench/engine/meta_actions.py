"""Meta-actions to target speeds and lanes, and the answers of driver models to accelerations."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes, index
from charms_bench.world.actions import DEFAULT_ACTIONS, Actions, MetaAction, follows_profile
from charms_bench.world.profile import Profile
from charms_bench.world.road import is_reachable, side_lanes
from charms_bench.world.scene import Bools, Floats, Ints, Scene

BY_NOTHING, BY_TARGETS, BY_STEPS, FROM_PRESENT = range(4)
"""How a meta-action changes the target speed: not at all; to the next of the profile's target
speeds; by a step from the target speed; to the present speed and a change."""


class CommandRule(NamedTuple):
    """How A meta-actions change target speeds and lanes; SI units."""

    lanes: Ints
    """(A,) -1 to the left, 1 to the right."""
    ways: Ints
    """(A,) `BY_NOTHING` to `FROM_PRESENT`."""
    signs: Ints
    """(A,) 1 or -1 for `BY_TARGETS` and `BY_STEPS`, by the direction; actions of one direction
    count as repetitions."""
    changes: Floats
    """(A, S) what the action adds as the first of its direction, then as the second, and so on."""
    speeds: Floats
    """The profile's target speeds; empty if no action chooses between them."""
    lowest: float
    highest: float
    from_target_lane: bool
    """Whether lane commands count from the target lane; otherwise from the current lane."""


def command_rule(profile: Profile, actions: Sequence[MetaAction] = DEFAULT_ACTIONS) -> CommandRule:
    """How a profile's vehicles carry out the meta-actions of their policy."""
    speeds = profile.target_speeds_mps if follows_profile(actions) else ()
    steps = profile.target_speed_steps_mps or (profile.target_speed_step_mps,)
    rows: list[tuple[int, tuple[float, ...]]] = []
    for action in actions:
        if action.profile_step and speeds:
            rows.append((BY_TARGETS, (float(action.profile_step),)))
        elif action.profile_step:
            rows.append((BY_STEPS, tuple(action.profile_step * step for step in steps)))
        elif action.speed_steps_mps:
            rows.append((BY_STEPS, action.speed_steps_mps))
        elif action.speed_from_present_mps is not None:
            rows.append((FROM_PRESENT, (action.speed_from_present_mps,)))
        else:
            rows.append((BY_NOTHING, (0.0,)))
    longest = max(len(changes) for _, changes in rows)
    padded = [(*changes, *changes[-1:] * (longest - len(changes))) for _, changes in rows]
    ways, changes = np.array([way for way, _ in rows]), np.array(padded, dtype=np.float64)
    by_direction = (ways == BY_TARGETS) | (ways == BY_STEPS)
    return CommandRule(
        lanes=np.array([action.lanes for action in actions]),
        ways=ways,
        signs=np.sign(changes[:, 0]).astype(np.int64) * by_direction,
        changes=changes,
        speeds=np.array(speeds, dtype=np.float64),
        lowest=profile.target_speed_min_mps,
        highest=profile.target_speed_max_mps,
        from_target_lane=profile.lane_command_from == "target_lane",
    )


@compiled_of_scenes
def command(scene: Scene, rows: Ints, places: Ints, actions: Actions, rule: CommandRule) -> None:
    """Carries out the meta-actions (M,) of M vehicles [`ControlledVehicle.act`]."""
    road, target_speed, target_lane = scene.road, scene.target_speed, scene.target_lane
    for m in range(rows.size):
        b, i, action = rows[m], places[m], actions[m]
        if not 0 <= action < rule.ways.size:
            continue
        way, sign, step = rule.ways[action], rule.signs[action], 0
        if rule.changes.shape[1] > 1:
            count_repeats(scene, b, i, sign, rule.changes.shape[1])
            step = max(abs(scene.repeats[b, i]) - 1, 0)
        if way == BY_TARGETS:
            target_speed[b, i] = nearest_target_speed(scene.speed[b, i], sign, rule.speeds)
        elif way != BY_NOTHING:
            wanted = target_speed[b, i] if way == BY_STEPS else scene.speed[b, i]
            wanted += rule.changes[action, step]
            target_speed[b, i] = clip(wanted, rule.lowest, rule.highest)
        if rule.lanes[action] != 0:
            lane = target_lane[b, i] if rule.from_target_lane else scene.lane[b, i]
            left, right = side_lanes(road, lane)
            beside = right if rule.lanes[action] > 0 else left
            lane = beside if beside >= 0 else lane
            if is_reachable(road, lane, scene.x[b, i], scene.y[b, i]):
                target_lane[b, i] = lane


@compiled
def count_repeats(scene: Scene, b: int, i: int, sign: int, most: int) -> None:
    """Counts speed commands of one direction in a row, up to a number; 0 begins anew."""
    repeats = scene.repeats[b, i]
    if sign > 0:
        scene.repeats[b, i] = min(max(repeats, 0) + 1, most)
    elif sign < 0:
        scene.repeats[b, i] = max(min(repeats, 0) - 1, -most)
    else:
        scene.repeats[b, i] = 0


@compiled
def index_of(speed: float, speeds: Floats) -> int:
    """The index of the nearest target speed [`MDPVehicle.speed_to_index`]."""
    last = speeds.size - 1
    fraction = (speed - speeds[0]) / (speeds[-1] - speeds[0])
    return int(min(max(round(fraction * last), 0), last))


@compiled
def nearest_target_speed(speed: float, change: int, speeds: Floats) -> float:
    """[`MDPVehicle.speed_to_index` and `index_to_speed`], `change` indices further."""
    return float(speeds[min(max(index_of(speed, speeds) + change, 0), speeds.size - 1)])


@compiled_of_scenes
def choose_target_speeds(scene: Scene, rows: Ints, free: Bools, speeds: Floats) -> None:
    """Gives the vehicles of new scenes one of the target speeds, except those that are free."""
    for b in rows:
        for i in range(scene.x.shape[1]):
            if not free[b, i]:
                nearest = nearest_target_speed(scene.target_speed[b, i], 0, speeds)
                scene.target_speed[b, i] = nearest


@compiled_of_scenes
def obey(scene: Scene, rows: Ints, places: Ints, accelerations: Floats, lanes: Ints) -> None:
    """Sets what a driver model answered for its M vehicles.

    Crashed vehicles no longer obey [`IDMVehicle.act`].
    """
    is_wreck, wanted = scene.crashed.ravel(), scene.acceleration.ravel()
    target = scene.target_lane.ravel()
    for m in range(rows.size):
        i = index(rows[m] * scene.x.shape[1] + places[m])
        wanted[i] = wanted[i] if is_wreck[i] else accelerations[m]
        target[i] = target[i] if is_wreck[i] else lanes[m]
