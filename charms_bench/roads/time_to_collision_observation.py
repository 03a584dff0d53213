"""highway-env's observation `TimeToCollision` on its roads."""

import math

import numpy as np

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, not_zero
from charms_bench.roads.scenes import CONTINUOUS, Here, Row, Scenes, here_of, lane_of, vehicle_of
from charms_bench.world.lane_geometry import line_coordinates
from charms_bench.world.road_network import Network, leads_to
from charms_bench.world.scene import Observations

SIDES = 3
"""The observed lanes and target speeds: the ego's, and one to each side."""
DEPTH = 3
"""How many roads ahead another vehicle is considered."""
_BRANCHES = 64
"""Room for the branches of a search, of which no road of highway-env has so many."""


@compiled_of_scenes
def observe(scenes: Scenes, rows: Ints, ego_place: int, interval: float, out: Observations) -> None:
    """Writes the observations (B, 3, 3, T) of the ego at a place in the scenes `rows`.

    These are the costs of a collision at each multiple of `interval`, s, by target speed and lane
    [`TimeToCollisionObservation.observe`].
    """
    road, speeds, times = scenes.road, scenes.target_speeds, out.shape[3]
    grid = np.empty((speeds.size, road.lanes["lanes"].max(), times))
    branches = np.empty((3, _BRANCHES), dtype=np.int64)
    is_connected = np.empty(road.lanes.size, dtype=np.bool_)
    for b in rows:
        here = here_of(scenes, b)
        ego = vehicle_of(here, ego_place)
        row = lane_of(here, ego.lane)
        find_connected(road, ego, branches, is_connected)
        fill(here, ego_place, speeds, interval, is_connected, grid)
        for k in range(SIDES):
            speed = min(max(ego.speed_index + k - 1, 0), speeds.size - 1)
            for m in range(SIDES):
                lane = ego.lane - row.first + m - 1
                for t in range(times):
                    is_lane = 0 <= lane < row.lanes
                    out[b, k, m, t] = grid[speed, lane, t] if is_lane else 1.0


@compiled
def fill(
    here: Here, ego_place: int, speeds: Floats, interval: float, is_connected: Bools, grid: Floats
) -> None:
    """Fills a grid, by target speed, lane and time [`finite_mdp.compute_ttc_grid`].

    `is_connected` is that of `find_connected`.
    """
    ego = vehicle_of(here, ego_place)
    own = lane_of(here, ego.lane)
    s, _ = line_coordinates(own, ego.x, ego.y)
    grid[:] = 0.0
    for j in range(here.places):
        other = vehicle_of(here, j)
        if j == ego_place or other.kind < CONTINUOUS or not is_connected[other.lane]:
            continue
        row = lane_of(here, other.lane)
        first, after = 0, own.lanes
        if row.lanes == own.lanes:
            first, after = other.lane - row.first, other.lane - row.first + 1
        distance = line_coordinates(own, other.x, other.y)[0] - s
        facing = other.direction_x * ego.direction_x + other.direction_y * ego.direction_y
        margin = other.length / 2 + ego.length / 2
        for speed in range(speeds.size):
            own_speed = speeds[speed]
            if own_speed == other.speed:
                continue
            for edge, cost in ((0.0, 1.0), (-margin, 0.5), (margin, 0.5)):
                until = (distance + edge) / not_zero(own_speed - other.speed * facing)
                if until < 0:
                    continue
                for moment in (int(until / interval), math.ceil(until / interval)):
                    if 0 <= moment < grid.shape[2]:
                        for lane in range(first, after):
                            grid[speed, lane, moment] = max(grid[speed, lane, moment], cost)


@compiled
def find_connected(road: Network, ego: Row, branches: Ints, found: Bools) -> None:
    """Finds the lanes (L,) on the ego's road, before it, or on one of the next `DEPTH` roads.

    `branches` (3, `_BRANCHES`) is overwritten [`RoadNetwork.is_connected_road`, with the ego's
    route].
    """
    found[:] = False
    roads, steps, depths = branches
    roads[0], steps[0], depths[0] = road.lanes[ego.lane].first, ego.route_step, DEPTH
    count = 1
    while count:
        count -= 1
        current, step, depth = roads[count], steps[count], depths[count]
        for lane in range(found.size):
            first = road.lanes[lane].first
            found[lane] |= first == current or leads_to(road, first, current)
        has_route = step < ego.route_end
        if has_route and depth > 0 and ego.route_roads[step] == current:
            steps[count] += 1
            count += 1
        elif has_route and depth > 0 and leads_to(road, current, ego.route_roads[step]):
            roads[count], steps[count], depths[count] = ego.route_roads[step], step + 1, depth - 1
            count += 1
        elif depth > 0:
            row = road.lanes[current]
            for k in range(row.next_roads, row.next_roads + row.next_count):
                roads[count], steps[count], depths[count] = road.successors[k], step, depth - 1
                count += 1
