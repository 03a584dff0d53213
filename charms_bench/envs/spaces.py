"""Gymnasium's spaces of observations and actions."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from charms_bench.world.action_texts import described_actions
from charms_bench.world.actions import (
    CONTROLS,
    DEFAULT_ACTIONS,
    ActionsLike,
    meta_actions_of,
    outputs_of,
)
from charms_bench.world.interaction_observation import Interaction
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import (
    EGO,
    SPEED_SCALE_MPS,
    TRAINED_IN,
    Y_SCALE_M,
    Neighbours,
    Observation,
    described,
    neighbours,
)
from charms_bench.world.scene import SceneSettings


def spaces_of(
    settings: SceneSettings, observation: Observation = neighbours, like: ActionsLike = "meta"
) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
    """Gymnasium's spaces of the ego's observations and actions.

    In `neighbours` and `paper_neighbours`, the rows of other vehicles and an action mask are within
    [-1, 1]. The bounds of the ego's position across the road and of its velocity are twice the
    values that occur while it drives; with continuous actions, its position has no bounds.
    `interaction` is within [-1, 1]. Other observations have no bounds, as in highway-env.
    """
    actions: spaces.Space[Any] = spaces.Discrete(outputs_of(like))
    is_continuous = not meta_actions_of(like)
    if is_continuous:
        actions = spaces.Box(-1.0, 1.0, (len(CONTROLS),), np.float32)
    where: dict[str, Any] = {"environment": "Ego-v0", "decision_hz": settings.decision_hz}
    if not is_continuous and meta_actions_of(like) != DEFAULT_ACTIONS:
        where["actions"] = described_actions(meta_actions_of(like))
    if isinstance(observation, Neighbours | Kinematics | Interaction):
        where["observation"] = described(observation)
    if isinstance(observation, Interaction):
        bound = np.ones(observation.shape, dtype=np.float32)
        return trained_in(spaces.Box(-bound, bound, dtype=np.float32), where), actions
    if not isinstance(observation, Neighbours):
        space = spaces.Box(-np.inf, np.inf, observation.shape, np.float32)
        return trained_in(space, where), actions
    profile = settings.profile
    targets = (profile.target_speed_max_mps, *profile.target_speeds_mps)
    fastest = max(profile.speed_max_mps, -profile.speed_min_mps, profile.ego_speed_mps, *targets)
    high = np.ones(observation.shape, dtype=np.float32)
    high[EGO, 2] = 2 * settings.lanes * profile.lane_width_m / Y_SCALE_M
    if is_continuous:
        high[EGO, 2] = np.inf
    high[EGO, 3:] = 2 * fastest / SPEED_SCALE_MPS
    return trained_in(spaces.Box(-high, high, dtype=np.float32), where), actions


def trained_in(space: spaces.Space[Any], where: Mapping[str, Any]) -> spaces.Space[Any]:
    """The space of an environment's observations, which says which environment it is.

    Checkpoints of Stable-Baselines3 have the attributes of a space as text.
    """
    setattr(space, TRAINED_IN, dict(where))
    return space
