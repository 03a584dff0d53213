"""The order of vehicles along the road, and the nearest ones on the candidate lanes of each."""

import numpy as np

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled, index, inlined
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT, TARGET, follower_on, leader_on
from charms_bench.world.road import (
    NEIGHBOUR_MARGIN_M,
    Straight,
    closest_lane,
    is_near_lane,
    is_on_length,
    local_coordinates,
    side_lanes,
)
from charms_bench.world.scene import Ints, Scene


@compiled
def locate(scene: Scene, rows: Ints) -> None:
    """Computes what follows from x, y and heading: directions, lanes, order and neighbours."""
    road, heading = scene.road, scene.heading
    for b in rows:
        for i in range(scene.x.shape[1]):
            scene.direction_y[b, i], scene.direction_x[b, i] = maths.sin_cos(heading[b, i])
            scene.lane[b, i] = closest_lane(road, scene.x[b, i], scene.y[b, i], heading[b, i])
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
    """Fills `leaders` and `followers`, along the order of `sort_by_x` and back."""
    road, vehicles = scene.road, scene.x.shape[1]
    nearest = np.empty(road.lanes + 2, dtype=np.int32)  # the first and the last lane do not exist
    for b in range(first, after):
        x, y, order = scene.x[b], scene.y[b], scene.order[b]
        lane, target_lane = scene.lane[b], scene.target_lane[b]
        leaders, followers = scene.leaders[b], scene.followers[b]
        any_level = False
        last_x = -np.inf
        nearest[:] = -1
        for k in range(vehicles):
            i = index(order[k])
            note_nearest(followers, i, lane[i], target_lane[i], nearest)
            pass_vehicle(road, order[k], x[i], y[i], lane[i], nearest)
            any_level |= x[i] == last_x
            last_x = x[i]
        nearest[:] = -1
        for k in range(vehicles - 1, -1, -1):
            last = order[index(k)]
            i = index(last)
            note_nearest(leaders, i, lane[i], target_lane[i], nearest)
            pass_vehicle(road, last, x[i], y[i], lane[i], nearest)
        if any_level:
            for k in range(1, vehicles):
                if x[order[k - 1]] == x[order[k]]:
                    search_neighbours(b, order[k], scene)


@inlined
def note_nearest(found: Ints, i: int, lane: int, target_lane: int, nearest: Ints) -> None:
    """Fills in the neighbours of vehicle i from the nearest vehicles (L + 2,) on all lanes."""
    found[i, OWN], found[i, TARGET] = nearest[index(lane + 1)], nearest[index(target_lane + 1)]
    found[i, LEFT], found[i, RIGHT] = nearest[index(lane)], nearest[index(lane + 2)]


@inlined
def pass_vehicle(road: Straight, i: int, x: float, y: float, lane: int, nearest: Ints) -> None:
    """Makes vehicle i the nearest one on its lanes."""
    if not is_on_length(road, x):
        return
    # So close to the middle of a lane, a vehicle is on no other one, however sums are rounded.
    _, beside = local_coordinates(road, lane, x, y)
    if abs(beside) <= road.lane_width / 2 - NEIGHBOUR_MARGIN_M - 1e-6:
        nearest[index(lane + 1)] = i
        return
    for on in range(road.lanes):
        if is_near_lane(road, on, y):
            nearest[index(on + 1)] = i


@compiled
def search_neighbours(b: int, i: int, scene: Scene) -> None:
    """Fills in the neighbours of vehicle i of scene b, one lane after the other."""
    lane = scene.lane[b, i]
    left, right = side_lanes(scene.road, lane)
    lanes = ((OWN, lane), (LEFT, left), (RIGHT, right), (TARGET, scene.target_lane[b, i]))
    for column, on in lanes:
        scene.leaders[b, i, column] = leader_on(b, i, on, scene) if on >= 0 else -1
        scene.followers[b, i, column] = follower_on(b, i, on, scene) if on >= 0 else -1
