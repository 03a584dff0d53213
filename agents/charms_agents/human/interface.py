"""A driver's speeds, driven by meta-actions: the actions that come closest to them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.meta_actions import FROM_PRESENT, command_rule
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.profile import Profile
from charms_bench.world.scene import Floats, Ints

SIMULATION_HZ, DECISION_HZ = 15, 3


class Commanded(NamedTuple):
    """How M drivers are driven by meta-actions over D decisions."""

    actions: NDArray[np.int64]
    """(D, M) indices into the meta-actions, by default FASTER, IDLE or SLOWER."""
    speed: Floats
    """(D + 1, M) the speed before each decision, and after the last, m/s."""
    target_speed: Floats
    """(D, M) the target speed before each decision, m/s."""
    repeats: Ints
    """(D, M) how often FASTER, or SLOWER if it is negative, was the last action in a row; 0 if the
    steps do not grow."""
    acceleration: Floats
    """(D, M) the command of the last simulation step before each decision, m/s2."""


def through_interface(
    speeds: Floats, profile: Profile, actions: Sequence[MetaAction] = DEFAULT_ACTIONS
) -> Commanded:
    """Drives M drivers by the meta-action after which their speed is the nearest to the given one.

    Args:
        speeds: (D + 1, M) at decisions, `DECISION_HZ` times a second.
        profile: Its steps and its speed controller; its bounds of speeds do not count.
        actions: The meta-actions; those that change the lane are not taken.
    """
    rule = command_rule(profile.model_copy(update={"target_speeds_mps": ()}), actions)
    options = np.flatnonzero(rule.lanes == 0)
    changes, most = rule.changes[options], rule.changes.shape[1]
    signs, relative = rule.signs[options, None], rule.ways[options, None] == FROM_PRESENT
    frames = SIMULATION_HZ // DECISION_HZ
    controlled = 1 if profile.ego_control_rate == "decision" else frames
    decisions, count = len(speeds) - 1, speeds.shape[1]
    speed, target, last = speeds[0].copy(), speeds[0].copy(), np.zeros(count)
    repeats = np.zeros(count, dtype=np.int64)
    result = Commanded(
        np.empty((decisions, count), dtype=np.int64),
        np.empty(speeds.shape),
        np.empty((decisions, count)),
        np.empty((decisions, count), dtype=np.int64),
        np.empty((decisions, count)),
    )
    result.speed[0] = speed
    for k in range(decisions):
        result.target_speed[k], result.acceleration[k] = target, last
        result.repeats[k] = repeats if most > 1 else 0  # as the engine counts
        again = np.minimum(np.where(signs * repeats > 0, abs(repeats) + 1, 1), most)
        step = np.take_along_axis(changes, again - 1, axis=1)
        aimed = np.where(relative, speed, target) + step
        after, acceleration = np.broadcast_to(speed, aimed.shape), np.zeros(aimed.shape)
        for frame in range(frames):
            if frame < controlled:
                acceleration = (aimed - after) / profile.tau_acceleration_s
            after = after + acceleration / SIMULATION_HZ
        # Of options that are equally near, the slowest, as for the first of them in order.
        best = np.lexsort((after.T, abs(after - speeds[k + 1]).T))[:, 0]
        rows = best, np.arange(count)
        result.actions[k] = options[best]
        speed, target, last = after[rows], aimed[rows], acceleration[rows]
        repeats = (signs * again)[rows]
        result.speed[k + 1] = speed
    return result
