"""Labels of recorded driving: a distribution over the meta-actions for each decision."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.scene import Floats, SceneSettings

ACCELERATION_MPS2 = 0.2
"""A stronger acceleration counts as intended."""
LATERAL_SPEED_MPS = 0.07
"""A faster drift away from the centre of the lane counts as intended."""


class Columns(NamedTuple):
    """The places, among meta-actions, of those whose probabilities labels have."""

    left: int
    idle: int
    right: int
    faster: int
    slower: int


def columns_of(actions: Sequence[MetaAction]) -> Columns:
    """The first meta-actions that only change the lane, do nothing, or only step the speed.

    Raises:
        InputError: There is no such action.
    """
    kinds = [
        (each.lanes, each.profile_step or int(np.sign(sum(each.speed_steps_mps))))
        if each.speed_from_present_mps is None
        else None
        for each in actions
    ]
    wanted = {"left": (-1, 0), "idle": (0, 0), "right": (1, 0), "faster": (0, 1), "slower": (0, -1)}
    for name, kind in wanted.items():
        if kind not in kinds:
            what = "people's driving is learnt as single changes of the lane or of the target speed"
            raise InputError(f"actions: no meta-action means only '{name}'; {what}")
    return Columns(*(kinds.index(kind) for kind in wanted.values()))


def brakings(
    actions: Sequence[MetaAction], scene: SceneSettings, decision_hz: float
) -> dict[int, float]:
    """The mean deceleration over a decision, m/s2, of each meta-action that brakes by a set value.

    It sets the target speed below the present speed, and the profile's speed controller follows.
    """
    frames = round(scene.simulation_hz / decision_hz)
    gain = 1 / (scene.simulation_hz * scene.profile.tau_acceleration_s)
    lost = 1 - (1 - gain) ** frames
    if scene.profile.ego_control_rate == "decision":
        lost = frames * gain
    return {
        k: -change * lost * decision_hz
        for k, each in enumerate(actions)
        if not each.lanes and (change := each.speed_from_present_mps or 0.0) < 0
    }


Labels = NDArray[np.float32]
Intents = NDArray[np.int8]


def longitudinal_intents(acceleration: Floats) -> Intents:
    """(M,) 1 for faster, -1 for slower, 0 for neither, from accelerations along the road, m/s2."""
    intended = np.abs(acceleration) > ACCELERATION_MPS2
    return np.where(intended, np.sign(acceleration), 0).astype(np.int8)


def lateral_intents(lateral_speed: Floats, offset: Floats) -> Intents:
    """(M,) 1 for a move to the right, -1 for a move to the left, 0 for neither.

    Args:
        lateral_speed: (M,) to the right, m/s.
        offset: (M,) position to the right of the lane's centre, m.
    """
    intended = (np.abs(lateral_speed) > LATERAL_SPEED_MPS) & (lateral_speed * offset > 0)
    return np.where(intended, np.sign(lateral_speed), 0).astype(np.int8)


def soft_labels(
    longitudinal: Intents,
    lateral: Intents,
    acceleration: Floats,
    lateral_speed: Floats,
    actions: Sequence[MetaAction] = DEFAULT_ACTIONS,
) -> Labels:
    """(M, A) probabilities of A meta-actions for the M rows of a data set.

    A row with one intent has one certain action. A row without an intent is IDLE. In a row with
    two intents, the two actions share the probability in proportion to their magnitudes, each
    divided by its mean over the data set (CHARMS eqs. 9 and 10).
    """
    a, v = np.abs(acceleration), np.abs(lateral_speed)
    both = (longitudinal != 0) & (lateral != 0)
    p_speed = (longitudinal != 0).astype(np.float64)
    p_lane = (lateral != 0).astype(np.float64)
    if both.any():
        a_relative, v_relative = a[both] / a.mean(), v[both] / v.mean()
        p_speed[both] = a_relative / (a_relative + v_relative)  # eq. 9
        p_lane[both] = v_relative / (a_relative + v_relative)  # eq. 10
    columns = columns_of(actions)
    labels = np.zeros((longitudinal.size, len(actions)), dtype=np.float32)
    labels[:, columns.faster] = np.where(longitudinal > 0, p_speed, 0.0)
    labels[:, columns.slower] = np.where(longitudinal < 0, p_speed, 0.0)
    labels[:, columns.left] = np.where(lateral < 0, p_lane, 0.0)
    labels[:, columns.right] = np.where(lateral > 0, p_lane, 0.0)
    labels[:, columns.idle] = (longitudinal == 0) & (lateral == 0)
    return labels


def step_labels(
    lateral: Intents,
    acceleration: Floats,
    strongest_mps2: float,
    actions: Sequence[MetaAction] = DEFAULT_ACTIONS,
    braking_mps2: Mapping[int, float] = MappingProxyType({}),
) -> Labels:
    """(M, A) probabilities of A meta-actions for drivers whose speed commands are small steps.

    A lane change is certain. Otherwise, FASTER or SLOWER has the probability |a| / `strongest_mps2`
    (at most 1), so that on average the steps accelerate as the driver does. A driver who brakes
    harder than steps can takes SLOWER or the next harder braking, so that their mean is the
    driver's braking.

    Args:
        lateral: (M,) 1 for a move to the right, -1 for a move to the left, 0 for neither.
        acceleration: (M,) the mean acceleration that follows, m/s2.
        strongest_mps2: The acceleration if every decision is a step.
        actions: The meta-actions.
        braking_mps2: Those that brake by a set value, and how hard; see `brakings`.
    """
    stays, size, columns = lateral == 0, np.abs(acceleration), columns_of(actions)
    labels = np.zeros((lateral.size, len(actions)), dtype=np.float32)
    labels[:, columns.left], labels[:, columns.right] = lateral < 0, lateral > 0
    labels[:, columns.idle] = stays
    harder = sorted((braking, k) for k, braking in braking_mps2.items() if braking > strongest_mps2)
    for sign, step, more in ((1, columns.faster, []), (-1, columns.slower, harder)):
        commands = [(0.0, columns.idle), (strongest_mps2, step), *more]
        for (low, below), (high, above) in pairwise(commands):
            between = stays & (sign * acceleration > low)
            p = np.minimum((size - low) / (high - low), 1.0)
            labels[:, above] = np.where(between, p, labels[:, above])
            labels[:, below] = np.where(between, 1.0 - p, labels[:, below])
    return labels
