"""The order of vehicles along the road, and the nearest ones ahead and behind on each lane."""

import numpy as np

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled, index
from charms_bench.world.road import (
    NEIGHBOUR_MARGIN_M,
    closest_lane,
    is_near_lane,
    is_on_lane,
    is_on_length,
)
from charms_bench.world.scene import Ints, Scene


@compiled
def locate(scene: Scene, rows: Ints) -> None:
    """Computes what follows from x, y and heading: directions, lanes, order and neighbours."""
    c, heading = scene.constants, scene.heading
    for b in rows:
        for i in range(scene.x.shape[1]):
            scene.direction_y[b, i], scene.direction_x[b, i] = maths.sin_cos(heading[b, i])
            scene.lane[b, i] = closest_lane(c, scene.x[b, i], scene.y[b, i], heading[b, i])
        sort_by_x(scene, b, b + 1)
        find_neighbours(scene, b, b + 1)


@compiled
def sort_by_x(scene: Scene, first: int, after: int) -> None:
    """Restores `order` and `rank`: by x, and at equal x in reverse order of entry.

    The vehicles are nearly sorted, so this is an insertion sort.
    """
    x, order, rank, entry = scene.x, scene.order, scene.rank, scene.entry
    for b in range(first, after):
        last = order[b, 0]
        last_x = x[b, last]
        for k in range(1, order.shape[1]):
            i = order[b, k]
            own_x = x[b, i]
            if last_x < own_x or (last_x == own_x and entry[b, last] > entry[b, i]):
                last, last_x = i, own_x
                continue
            m = k
            while m > 0:
                j = order[b, m - 1]
                if x[b, j] < own_x or (x[b, j] == own_x and entry[b, j] > entry[b, i]):
                    break
                order[b, m] = j
                rank[b, j] = m
                m -= 1
            order[b, m] = i
            rank[b, i] = m


@compiled
def find_neighbours(scene: Scene, first: int, after: int) -> None:
    """Fills `leaders` and `followers` [`Road.neighbour_vehicles` for each lane].

    A vehicle is on a lane up to 1 m beside it, so it may be on two. Vehicles at equal x are each
    other's leaders, but not followers. Among several, the last to enter is the leader and the first
    to enter is the follower; the order of `sort_by_x` gives this.
    """
    c, vehicles = scene.constants, scene.x.shape[1]
    sorted_y = np.empty(vehicles)  # not a number, so on no lane, for a vehicle beyond the ends
    for b in range(first, after):
        x, y, order = scene.x[b], scene.y[b], scene.order[b]
        leaders, followers = scene.leaders[b], scene.followers[b]
        any_level = False
        last_x = -np.inf
        for k in range(vehicles):
            i = index(order[k])
            sorted_y[k] = y[i] if is_on_length(c, x[i]) else np.nan
            any_level |= x[i] == last_x
            last_x = x[i]
        for lane in range(c.lanes):
            on = index(lane)
            nearest = np.int32(-1)
            for k in range(vehicles):
                followers[index(order[k]), on] = nearest
                nearest = order[k] if is_near_lane(c, lane, sorted_y[k]) else nearest
            nearest = np.int32(-1)
            for k in range(vehicles - 1, -1, -1):
                at = index(k)
                leaders[index(order[at]), on] = nearest
                nearest = order[at] if is_near_lane(c, lane, sorted_y[at]) else nearest
        if any_level:
            for k in range(1, vehicles):
                if x[order[k - 1]] == x[order[k]]:
                    find_level_neighbours(b, k, scene)


@compiled
def find_level_neighbours(b: int, k: int, scene: Scene) -> None:
    """Corrects the neighbours of the k-th vehicle, which has the same x as the one before it."""
    c, x, order = scene.constants, scene.x, scene.order
    i = order[b, k]
    for on in range(c.lanes):
        scene.followers[b, i, on] = scene.followers[b, order[b, k - 1], on]
    m = k - 1
    while m >= 0 and x[b, order[b, m]] == x[b, i]:
        j = order[b, m]
        for on in range(c.lanes):
            if is_on_lane(c, on, x[b, j], scene.y[b, j], NEIGHBOUR_MARGIN_M):
                scene.leaders[b, i, on] = j
        m -= 1
