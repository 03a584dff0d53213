"""Shortest ways over a network of lanes to any of its roads.

A way follows lanes and changes between neighbours. For each goal and each lane, a table says where
the way goes on, so that it costs the same memory however many vehicles there are. A vehicle has the
next steps of its way as a route of highway-env: the first lane of a road, and the number of a lane
on it. On the vehicle's own road, the number is left open where every lane of the road leads on for
`OPEN_M` without a lane change.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled
from charms_bench.roads.scenes import ROUTE_STEPS, Row
from charms_bench.world.road_network import Network

MOST_GOALS = 1000
"""Of more roads, evenly many are goals, because the tables grow with their number."""
LANE_CHANGE_M, SHORT_LANE_CHANGE_M = 30.0, 300.0
"""As long a detour is taken to save a lane change, or one on a road shorter than the first."""
OPEN_M = 200.0
_AT_GOAL_M = 1e-3


class Routes(NamedTuple):
    """The ways from L lanes to G goals."""

    goals: Ints
    """[G] the first lane of each goal's road."""
    following: Ints
    """[G, L] the lane after each lane on the way; -1 on the goal's road, or where there is none."""
    distance: Floats
    """[G, L] from each lane's start to the goal's, m, with `LANE_CHANGE_M` for each lane change;
    infinity without a way."""
    free: Floats
    """[G, L] how far the way leads from each lane's start without a lane change, m."""


class Net(NamedTuple):
    """By what vehicles find their ways on a road in a file."""

    routes: Routes
    inside: Ints
    """(L,) whether each lane is in a junction."""
    links: Ints
    """The lanes that follow each lane, lane after lane."""
    ends: Ints
    """(L,) the number of links up to each lane."""


def routes_of(road: Network, links: Sequence[Sequence[int]], goals: Ints) -> Routes:
    """The ways to the roads with the first lanes `goals` (G,); `links` follow each lane."""
    table = road.lanes
    count, lengths = table.size, table["length"]
    goals = goals[np.linspace(0, goals.size - 1, min(goals.size, MOST_GOALS)).astype(np.int64)]
    edges = [(lane, after, lengths[lane]) for lane, each in enumerate(links) for after in each]
    for lane, row in enumerate(table):
        cost = LANE_CHANGE_M if row["length"] >= LANE_CHANGE_M else SHORT_LANE_CHANGE_M
        edges += [(lane, beside, cost) for beside in (row["left"], row["right"]) if beside >= 0]
    for k, first in enumerate(goals.tolist()):
        edges += [
            (lane, count + k, _AT_GOAL_M) for lane in range(first, first + table["lanes"][first])
        ]
    start, end, cost = np.array(edges).T
    order = np.lexsort((cost, start, end))
    start, end, cost = start[order].astype(int), end[order].astype(int), cost[order]
    is_first = np.append(True, (np.diff(start) != 0) | (np.diff(end) != 0))
    ends = end[is_first], start[is_first]
    backwards = csr_array((cost[is_first], ends), shape=(count + goals.size,) * 2)
    own = count + np.arange(goals.size)
    distance, before = dijkstra(backwards, indices=own, return_predecessors=True)
    following = before[:, :count].astype(np.int32)
    following[(following < 0) | (following >= count)] = -1
    distance = np.ascontiguousarray(distance[:, :count])
    is_link = np.zeros((count, 2), dtype=np.bool_)
    for lane, each in enumerate(links):
        is_link[lane] = [beside in each for beside in (lane - 1, lane + 1)]
    free = np.empty(distance.shape)
    _fill_free(road, is_link, following, distance, free)
    return Routes(goals, following, distance, free)


@compiled
def _fill_free(
    road: Network, is_link: np.ndarray, following: Ints, distance: Floats, free: Floats
) -> None:
    """Fills in `Routes.free`; `is_link` (L, 2) says whether the lanes beside follow a lane."""
    for g in range(distance.shape[0]):
        for lane in np.argsort(distance[g]):
            after = following[g, lane]
            if after < 0:
                free[g, lane] = np.inf if distance[g, lane] < np.inf else 0.0
            elif road.lanes[after].first == road.lanes[lane].first and not (
                is_link[lane, 0] if after < lane else is_link[lane, 1]
            ):
                free[g, lane] = 0.0
            else:
                free[g, lane] = road.lanes[lane].length + free[g, after]


@compiled
def plan_way(vehicle: Row, road: Network, routes: Routes, lane: int, is_there: bool) -> None:
    """Gives a vehicle the next steps of its way from a lane; none without a goal.

    `is_there` says whether the vehicle is on the lane. On each road to come, it should take the
    lane to which its way leads.
    """
    g, count = vehicle.goal, 0
    widest = road.lanes[vehicle.lane].lanes
    while g >= 0 and count < ROUTE_STEPS and routes.distance[g, lane] < np.inf:
        first = road.lanes[lane].first
        number = lane - first
        while routes.free[g, lane] == 0.0 and routes.following[g, lane] >= 0:
            lane = routes.following[g, lane]
        if is_there and count == 0:
            number, is_open = lane - first, road.lanes[first].lanes >= widest
            for k in range(first, first + road.lanes[first].lanes):
                is_open = is_open and routes.free[g, k] >= OPEN_M
            number = -1 if is_open else number
        vehicle.route_roads[count], vehicle.route_numbers[count] = first, number
        count += 1
        lane = routes.following[g, lane]
        if lane < 0:
            break
    vehicle.route_step, vehicle.route_end = 0, count
