"""What a recorded driver did, as a distribution over the meta-actions."""

import numpy as np
from numpy.typing import NDArray

from charms_bench.world.actions import ACTIONS, FASTER, IDLE, LANE_LEFT, LANE_RIGHT, SLOWER
from charms_bench.world.scene import Floats

ACCELERATION_MPS2 = 0.2
"""A stronger acceleration is meant."""
LATERAL_SPEED_MPS = 0.07
"""A faster drift away from the lane's centre is meant."""

Labels = NDArray[np.float32]
Intents = NDArray[np.int8]


def longitudinal_intents(acceleration: Floats) -> Intents:
    """(M,) 1 faster, -1 slower, 0 neither; of accelerations along the road, m/s2."""
    meant = np.abs(acceleration) > ACCELERATION_MPS2
    return np.where(meant, np.sign(acceleration), 0).astype(np.int8)


def lateral_intents(lateral_speed: Floats, offset: Floats) -> Intents:
    """(M,) 1 to the right, -1 to the left, 0 neither.

    Args:
        lateral_speed: (M,) to the right, m/s.
        offset: (M,) position right of the centre of the lane, m.
    """
    meant = (np.abs(lateral_speed) > LATERAL_SPEED_MPS) & (lateral_speed * offset > 0)
    return np.where(meant, np.sign(lateral_speed), 0).astype(np.int8)


def soft_labels(
    longitudinal: Intents, lateral: Intents, acceleration: Floats, lateral_speed: Floats
) -> Labels:
    """(M, 5) probabilities of `ACTIONS` for the M rows of a data set.

    One intent is one action, none is IDLE. Two share the probability, CHARMS eq. 9 and 10, by
    their magnitudes, each divided by its mean over the data set.
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
