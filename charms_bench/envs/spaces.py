"""Gymnasium's spaces of observations and actions."""

from typing import Any

import numpy as np
from gymnasium import spaces

from charms_bench.world.actions import ACTIONS, CONTROLS, ActionKind
from charms_bench.world.observations import (
    EGO,
    SPEED_SCALE_MPS,
    Y_SCALE_M,
    Neighbours,
    Observation,
    neighbours,
)
from charms_bench.world.scene import SceneSettings


def spaces_of(
    settings: SceneSettings, observation: Observation = neighbours, kind: ActionKind = "meta"
) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
    """Gymnasium's spaces of the ego's observations and actions.

    In `neighbours` and `paper_neighbours`, the rows of other vehicles and an action mask are within
    [-1, 1]. The bounds of the ego's position across the road and of its velocity are twice the
    values that occur while it drives; with continuous actions, its position has no bounds. Other
    observations have no bounds, as in highway-env.
    """
    actions: spaces.Space[Any] = spaces.Discrete(len(ACTIONS))
    if kind == "continuous":
        actions = spaces.Box(-1.0, 1.0, (len(CONTROLS),), np.float32)
    if not isinstance(observation, Neighbours):
        return spaces.Box(-np.inf, np.inf, observation.shape, np.float32), actions
    profile = settings.profile
    targets = (profile.target_speed_max_mps, *profile.target_speeds_mps)
    fastest = max(profile.speed_max_mps, -profile.speed_min_mps, profile.ego_speed_mps, *targets)
    high = np.ones(observation.shape, dtype=np.float32)
    high[EGO, 2] = 2 * settings.lanes * profile.lane_width_m / Y_SCALE_M
    if kind == "continuous":
        high[EGO, 2] = np.inf
    high[EGO, 3:] = 2 * fastest / SPEED_SCALE_MPS
    return spaces.Box(-high, high, dtype=np.float32), actions
