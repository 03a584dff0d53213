"""A driver's speeds, driven by meta-actions: the actions that come closest to them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.world.actions import FASTER, IDLE, SLOWER
from charms_bench.world.profile import Profile
from charms_bench.world.scene import Floats, Ints

SIMULATION_HZ, DECISION_HZ = 15, 3


class Commanded(NamedTuple):
    """How M drivers are driven by meta-actions over D decisions."""

    actions: NDArray[np.int64]
    """(D, M) FASTER, IDLE or SLOWER."""
    speed: Floats
    """(D + 1, M) the speed before each decision, and after the last, m/s."""
    target_speed: Floats
    """(D, M) the target speed before each decision, m/s."""
    repeats: Ints
    """(D, M) how often FASTER, or SLOWER if it is negative, was the last action in a row; 0 if the
    steps do not grow."""
    acceleration: Floats
    """(D, M) the command of the last simulation step before each decision, m/s2."""


def through_interface(speeds: Floats, profile: Profile) -> Commanded:
    """Drives M drivers by the meta-action after which their speed is the nearest to the given one.

    Args:
        speeds: (D + 1, M) at decisions, `DECISION_HZ` times a second.
        profile: Its steps and its speed controller; its bounds of speeds do not count.
    """
    steps = np.array(profile.target_speed_steps_mps or (profile.target_speed_step_mps,))
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
    signs, actions = np.array([0, 1, -1])[:, None], np.array([IDLE, FASTER, SLOWER])
    result.speed[0] = speed
    for k in range(decisions):
        result.target_speed[k], result.acceleration[k] = target, last
        result.repeats[k] = repeats if steps.size > 1 else 0  # as the engine counts
        again = np.where(signs * repeats > 0, abs(repeats) + 1, 1)
        aimed = target + signs * steps[np.minimum(again, steps.size) - 1]
        after, held = np.broadcast_to(speed, aimed.shape), np.zeros(aimed.shape)
        for frame in range(frames):
            if frame < controlled:
                held = (aimed - after) / profile.tau_acceleration_s
            after = after + held / SIMULATION_HZ
        # Of options that are equally near, the slowest, as for the first of them in order.
        best = np.lexsort((after.T, abs(after - speeds[k + 1]).T))[:, 0]
        rows = best, np.arange(count)
        result.actions[k] = actions[best]
        speed, target, last = after[rows], aimed[rows], held[rows]
        repeats = (signs * np.minimum(again, steps.size))[rows]
        result.speed[k + 1] = speed
    return result
