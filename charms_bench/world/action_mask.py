"""Which meta-actions of a vehicle have an effect where the road ends at its side."""

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.world.actions import ACTIONS, LANE_LEFT, LANE_RIGHT
from charms_bench.world.road import side_lanes
from charms_bench.world.scene import Ints, Scene, Vehicles

ActionMasks = NDArray[np.int8]
"""(M, 5): 1 for each meta-action that a vehicle can carry out, and 0 for a lane change to a lane
that does not exist. The type is the one that Gymnasium's spaces sample with."""


def action_masks(scene: Scene, vehicles: Vehicles) -> ActionMasks:
    """The action masks (M, 5) of M vehicles.

    `LANE_LEFT` is 0 if the vehicle is on the leftmost lane and steers to no other lane, and
    `LANE_RIGHT` likewise on the rightmost lane. Such a command has no effect, because the lane is
    clipped to the road [`ControlledVehicle.act`]. On the way to another lane, the same command ends
    the lane change, and its mask is 1. All other actions are always 1.
    """
    masks = np.ones((vehicles[0].size, len(ACTIONS)), dtype=np.int8)
    _close(scene, vehicles[0], vehicles[1], masks)
    return masks


@compiled_of_scenes
def _close(scene: Scene, rows: Ints, places: Ints, masks: ActionMasks) -> None:
    """Writes 0 for the lane changes of M vehicles to lanes that do not exist."""
    for m in range(rows.size):
        own = side_lanes(scene.road, scene.lane[rows[m], places[m]])
        wanted = side_lanes(scene.road, scene.target_lane[rows[m], places[m]])
        masks[m, LANE_LEFT] = own[0] >= 0 or wanted[0] >= 0
        masks[m, LANE_RIGHT] = own[1] >= 0 or wanted[1] >= 0
