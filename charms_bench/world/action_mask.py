"""Which meta-actions of a vehicle have an effect where the road ends at its side."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.world.actions import DEFAULT_ACTIONS, IDLE, LANE_LEFT, LANE_RIGHT, MetaAction
from charms_bench.world.road import side_lanes
from charms_bench.world.scene import Ints, Scene, Vehicles

M = TypeVar("M", bound=np.generic)
ActionMasks = NDArray[np.int8]
"""(M, A): 1 for each meta-action that a vehicle can carry out, and 0 for a lane change to a lane
that does not exist. The type is the one that Gymnasium's spaces sample with."""


def action_masks(
    scene: Scene, vehicles: Vehicles, actions: Sequence[MetaAction] = DEFAULT_ACTIONS
) -> ActionMasks:
    """The action masks (M, A) of M vehicles.

    An action that changes the lane to the left is 0 if the vehicle is on the leftmost lane and
    steers to no other lane, and one that changes it to the right likewise on the rightmost lane.
    The lane command has no effect then, because the lane is clipped to the road
    [`ControlledVehicle.act`]. On the way to another lane, the same command ends the lane change,
    and its mask is 1. All other actions are always 1.
    """
    masks = np.ones((vehicles[0].size, len(DEFAULT_ACTIONS)), dtype=np.int8)
    _close(scene, vehicles[0], vehicles[1], masks)
    return masks_of(masks, actions)


def masks_of(masks: NDArray[M], actions: Sequence[MetaAction]) -> NDArray[M]:
    """The action masks (M, A) of any meta-actions, from those (M, 5) of `DEFAULT_ACTIONS`."""
    lanes = [action.lanes for action in actions]
    if lanes == [action.lanes for action in DEFAULT_ACTIONS]:
        return masks
    return masks[:, [(LANE_LEFT, IDLE, LANE_RIGHT)[side + 1] for side in lanes]]


@compiled_of_scenes
def _close(scene: Scene, rows: Ints, places: Ints, masks: ActionMasks) -> None:
    """Writes 0 for the lane changes of M vehicles to lanes that do not exist."""
    for m in range(rows.size):
        own = side_lanes(scene.road, scene.lane[rows[m], places[m]])
        wanted = side_lanes(scene.road, scene.target_lane[rows[m], places[m]])
        masks[m, LANE_LEFT] = own[0] >= 0 or wanted[0] >= 0
        masks[m, LANE_RIGHT] = own[1] >= 0 or wanted[1] >= 0
