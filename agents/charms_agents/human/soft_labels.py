"""Labels of recorded driving: a distribution over the meta-actions for each decision."""

import numpy as np
from numpy.typing import NDArray

from charms_bench.world.actions import ACTIONS, FASTER, IDLE, LANE_LEFT, LANE_RIGHT, SLOWER
from charms_bench.world.scene import Floats

ACCELERATION_MPS2 = 0.2
"""A stronger acceleration counts as intended."""
LATERAL_SPEED_MPS = 0.07
"""A faster drift away from the centre of the lane counts as intended."""

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
    longitudinal: Intents, lateral: Intents, acceleration: Floats, lateral_speed: Floats
) -> Labels:
    """(M, 5) probabilities of `ACTIONS` for the M rows of a data set.

    A row with one intent has one certain action. A row without an intent is IDLE. In a row with
    two intents, the two actions share the probability in proportion to their magnitudes, each
    divided by its mean over the data set (CHARMS eqs. 9 and 10).
    """
    a, v = np.abs(acceleration), np.abs(lateral_speed)
    both = (longitudinal != 0) & (lateral != 0)
    p_speed = (longitudinal != 0).astype(np.float64)
    p_lane = (lateral != 0).astype(np.float64)
    if both.any():
        a_share, v_share = a[both] / a.mean(), v[both] / v.mean()
        p_speed[both] = a_share / (a_share + v_share)  # eq. 9
        p_lane[both] = v_share / (a_share + v_share)  # eq. 10
    labels = np.zeros((longitudinal.size, len(ACTIONS)), dtype=np.float32)
    labels[:, FASTER] = np.where(longitudinal > 0, p_speed, 0.0)
    labels[:, SLOWER] = np.where(longitudinal < 0, p_speed, 0.0)
    labels[:, LANE_LEFT] = np.where(lateral < 0, p_lane, 0.0)
    labels[:, LANE_RIGHT] = np.where(lateral > 0, p_lane, 0.0)
    labels[:, IDLE] = (longitudinal == 0) & (lateral == 0)
    return labels


def step_labels(lateral: Intents, acceleration: Floats, strongest_mps2: float) -> Labels:
    """(M, 5) probabilities of `ACTIONS` for drivers whose speed commands are small steps.

    A lane change is certain. Otherwise, FASTER or SLOWER has the probability |a| / `strongest_mps2`
    (at most 1), so that on average the steps accelerate as the driver does.

    Args:
        lateral: (M,) 1 for a move to the right, -1 for a move to the left, 0 for neither.
        acceleration: (M,) the mean acceleration that follows, m/s2.
        strongest_mps2: The acceleration if every decision is a step.
    """
    stays = lateral == 0
    p = np.minimum(np.abs(acceleration) / strongest_mps2, 1.0)
    labels = np.zeros((lateral.size, len(ACTIONS)), dtype=np.float32)
    labels[:, LANE_LEFT], labels[:, LANE_RIGHT] = lateral < 0, lateral > 0
    labels[:, FASTER] = np.where(stays & (acceleration > 0), p, 0.0)
    labels[:, SLOWER] = np.where(stays & (acceleration < 0), p, 0.0)
    labels[:, IDLE] = np.where(stays, 1.0 - p, 0.0)
    return labels
