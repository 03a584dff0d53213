"""The lanes that a vehicle can be on next, and the nearest vehicles on a lane.

A scene lists the nearest vehicles ahead and behind on four lanes of every vehicle
(`Scene.leaders`, `Scene.followers`): the nearest lane, the lanes beside it and the target lane. On
any other lane, they are searched for. Both follow highway-env's rule (`Road.neighbour_vehicles`): a
vehicle is on a lane while its centre is at most half a lane and `NEIGHBOUR_MARGIN_M` from the
lane's centre, so it can be on two. Of vehicles at the same place along the road, each leads all
others and none follows another; the last to enter is the leader, and the first to enter is the
follower.
"""

import numpy as np

from charms_bench.foundation.arrays import Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.world.road import NEIGHBOUR_MARGIN_M, is_on_lane
from charms_bench.world.scene_arrays import SceneArrays

OWN, LEFT, RIGHT, TARGET = CANDIDATES = (0, 1, 2, 3)
"""The candidate lanes: the nearest lane, those on its left and right, and the target lane."""


@compiled
def leader_on(b: int, i: int, lane: int, scene: SceneArrays) -> int:
    """The nearest vehicle at or ahead of vehicle i of scene b on a lane, -1 for none."""
    x, y, order = scene.x, scene.y, scene.order
    for k in range(_first_level(b, i, scene), order.shape[1]):
        j = order[b, k]
        if j != i and is_on_lane(scene.road, lane, x[b, j], y[b, j], NEIGHBOUR_MARGIN_M):
            return int(j)
    return -1


@compiled
def follower_on(b: int, i: int, lane: int, scene: SceneArrays) -> int:
    """The nearest vehicle behind vehicle i of scene b on a lane, -1 for none."""
    x, y, order = scene.x, scene.y, scene.order
    for k in range(_first_level(b, i, scene) - 1, -1, -1):
        j = order[b, k]
        if is_on_lane(scene.road, lane, x[b, j], y[b, j], NEIGHBOUR_MARGIN_M):
            return int(j)
    return -1


@compiled
def _first_level(b: int, i: int, scene: SceneArrays) -> int:
    """The first index in `order` of a vehicle as far along the road as vehicle i."""
    x, order, k = scene.x, scene.order, scene.rank[b, i]
    while k > 0 and x[b, order[b, k - 1]] == x[b, i]:
        k -= 1
    return int(k)


@compiled_of_scenes
def neighbours_on(scene: SceneArrays, rows: Ints, places: Ints, lanes: Ints) -> Ints:
    """(2, M) the leaders and the followers of M vehicles, each on its lane of `lanes` (M,)."""
    found = np.empty((2, rows.size), dtype=np.int64)
    for m in range(rows.size):
        found[0, m] = leader_on(rows[m], places[m], lanes[m], scene)
        found[1, m] = follower_on(rows[m], places[m], lanes[m], scene)
    return found
