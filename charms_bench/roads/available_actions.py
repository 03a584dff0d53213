"""Which meta-actions have an effect now [`DiscreteMetaAction.get_available_actions`]."""

import numpy as np

from charms_bench.foundation.arrays import Bools
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.roads.scenes import Scenes
from charms_bench.world.actions import DEFAULT_ACTIONS, FASTER, LANE_LEFT, LANE_RIGHT, SLOWER
from charms_bench.world.road import is_reachable, side_lanes


def available_actions(scenes: Scenes, egos: int) -> Bools:
    """Whether each of highway-env's five meta-actions has an effect, (B, egos, 5)."""
    masks = np.ones((len(scenes.vehicles), egos, len(DEFAULT_ACTIONS)), dtype=np.bool_)
    _close(scenes, masks)
    return masks


@compiled_of_scenes
def _close(scenes: Scenes, masks: Bools) -> None:
    road, fastest = scenes.road, scenes.target_speeds.size - 1
    for b in range(masks.shape[0]):
        for i in range(masks.shape[1]):
            ego, mask = scenes.vehicles[b, i], masks[b, i]
            left, right = side_lanes(road, ego.lane)
            mask[LANE_LEFT] = is_reachable(road, left, ego.x, ego.y)
            mask[LANE_RIGHT] = is_reachable(road, right, ego.x, ego.y)
            mask[FASTER], mask[SLOWER] = ego.speed_index < fastest, ego.speed_index > 0
