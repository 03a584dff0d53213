"""Meta-actions to target speeds and lanes, and the answers of driver models to accelerations."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes, index
from charms_bench.world.actions import FASTER, LANE_LEFT, LANE_RIGHT, SLOWER, Actions
from charms_bench.world.profile import Profile
from charms_bench.world.road import is_reachable, side_lanes
from charms_bench.world.scene import Bools, Floats, Ints, Scene


class CommandRule(NamedTuple):
    """How meta-actions change target speeds and lanes; SI units."""

    speeds: Floats
    """The target speeds between which FASTER and SLOWER choose; empty if they add `steps`."""
    steps: Floats
    """What the first FASTER or SLOWER in a row adds, then the second, and so on; at least one."""
    lowest: float
    highest: float
    from_target_lane: bool
    """Whether lane commands count from the target lane; otherwise from the current lane."""


def command_rule(profile: Profile, own_steps: Sequence[float] = ()) -> CommandRule:
    """How a profile's vehicles carry out meta-actions, with the steps that their policy may own."""
    steps = own_steps or profile.target_speed_steps_mps or (profile.target_speed_step_mps,)
    return CommandRule(
        speeds=np.array(() if own_steps else profile.target_speeds_mps, dtype=np.float64),
        steps=np.array(steps, dtype=np.float64),
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
        step = 0
        if rule.steps.size > 1:
            count_repeats(scene, b, i, action, rule.steps.size)
            step = abs(scene.repeats[b, i]) - 1
        if action in (FASTER, SLOWER):
            change = 1 if action == FASTER else -1
            if rule.speeds.size:
                wanted = nearest_target_speed(scene.speed[b, i], change, rule.speeds)
            else:
                wanted = target_speed[b, i] + change * rule.steps[step]
                wanted = clip(wanted, rule.lowest, rule.highest)
            target_speed[b, i] = wanted
        elif action in (LANE_LEFT, LANE_RIGHT):
            lane = target_lane[b, i] if rule.from_target_lane else scene.lane[b, i]
            left, right = side_lanes(road, lane)
            beside = right if action == LANE_RIGHT else left
            lane = beside if beside >= 0 else lane
            if is_reachable(road, lane, scene.x[b, i], scene.y[b, i]):
                target_lane[b, i] = lane


@compiled
def count_repeats(scene: Scene, b: int, i: int, action: int, most: int) -> None:
    """Counts how often a vehicle's speed command has been given in a row, up to a number."""
    repeats = scene.repeats[b, i]
    if action == FASTER:
        scene.repeats[b, i] = min(max(repeats, 0) + 1, most)
    elif action == SLOWER:
        scene.repeats[b, i] = max(min(repeats, 0) - 1, -most)
    else:
        scene.repeats[b, i] = 0


@compiled
def nearest_target_speed(speed: float, change: int, speeds: Floats) -> float:
    """[`MDPVehicle.speed_to_index` and `index_to_speed`], `change` indices further."""
    last = speeds.size - 1
    share = (speed - speeds[0]) / (speeds[-1] - speeds[0])
    nearest = min(max(round(share * last), 0), last)
    return float(speeds[min(max(nearest + change, 0), last)])


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
