"""What the observation `interaction` says of the ways of vehicles on a network, compiled."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats
from charms_bench.foundation.compiled import borrowed, clip, compiled, compiled_of_scenes
from charms_bench.roads.configured_egos import ConfiguredEgos
from charms_bench.roads.conflicts import BEHIND as GIVES_WAY
from charms_bench.roads.conflicts import CROSSING, MERGING, Conflicts
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.scenes import BEHIND, OBSTACLE, WAY_LANES, Row, Scenes
from charms_bench.world.interaction_observation import (
    CLEAR_M,
    EGO,
    FIRST_CONFLICT,
    GOAL_RANGE_M,
    LANE_M,
    RANGE_M,
    SLOWEST_MPS,
    SPEED_MPS,
    TIME_S,
    TURN_WITHIN_M,
    WAY,
)
from charms_bench.world.road import heading_at, is_reachable, local_coordinates
from charms_bench.world.road_network import Network
from charms_bench.world.scene import Ints, Observations, Vehicles

_ON_LANE_COS, _ON_LANE_M = 0.8, 1.5
"""A vehicle is also on a lane that it is so close to, with such an angle to it: where lanes part,
they lie on each other."""


@dataclass(frozen=True)
class RoadJunctions:
    """The junctions of the scenes that an engine shows; see `world.scene.Junctions`."""

    episodes: Episodes
    views: int
    """How many views there are of each scene: one for each of its vehicles, or 1."""
    drivers: Ints
    """[B, N] the index of each vehicle's agent."""
    configured: Mapping[int, ConfiguredEgos]
    """The egos that observe by a configuration of highway-env, by the index of their agent."""

    def describe(
        self, vehicles: Vehicles, observations: Observations, occlusion: bool, exit_lanes: bool
    ) -> None:
        """Completes the observations `interaction` of M vehicles that have just been shown."""
        rows, places = vehicles[0] // self.views, vehicles[1]
        episodes = self.episodes
        known = episodes.scenes, episodes.conflicts
        _describe(*known, rows, places, occlusion, exit_lanes, observations)

    def observe(self, vehicles: Vehicles) -> NDArray[Any]:
        """The observations `highway_env` of M egos of one agent."""
        rows, places = vehicles[0] // self.views, vehicles[1]
        if (egos := self.configured.get(int(self.drivers[rows[0], places[0]]))) is None:
            raise InputError("the observation highway_env is that of an ego whose policy names it")
        return egos.observe(rows)


class _Meeting(NamedTuple):
    """Of each vehicle (N,), its first conflict with the way of an ego."""

    found: Bools
    conflict: Ints
    own: Floats
    """How far the ego is from the conflict point, m."""
    other: Floats
    """How far the vehicle is from it, m."""


@compiled_of_scenes
def _describe(
    scenes: Scenes,
    table: Conflicts,
    rows: Ints,
    places: Ints,
    occlusion: bool,
    exit_lanes: bool,
    out: Observations,
) -> None:
    count, known = scenes.vehicles.shape[1], borrowed(table)
    meeting = _Meeting(
        np.zeros(count, np.bool_), np.zeros(count, np.int64), np.zeros(count), np.zeros(count)
    )
    for m in range(rows.size):
        b, i = rows[m], places[m]
        _write_way(scenes, known, exit_lanes, b, i, out[m, EGO], out[m, WAY])
        _meet(scenes, known, b, i, meeting, out[m, WAY])
        for j in range(count if occlusion else 0):
            meeting.found[j] = meeting.found[j] and not _is_hidden(scenes, b, i, j)
        _write_conflicts(scenes, known, b, i, meeting, out[m])


@compiled
def _write_way(
    scenes: Scenes,
    table: Conflicts,
    exit_lanes: bool,
    b: int,
    i: int,
    own: Observations,
    way: Observations,
) -> None:
    """Writes what the road and the route say of the way of vehicle i."""
    road, vehicle = scenes.road, scenes.vehicles[b, i]
    lane = vehicle.lane
    row = road.lanes[lane]
    s, r = local_coordinates(road, lane, vehicle.x, vehicle.y)
    own[5] = clip(r / LANE_M, -1.0, 1.0)
    own[7] = clip(row.speed_limit / SPEED_MPS, 0.0, 1.0)
    way[0] = row.left >= 0 and is_reachable(road, row.left, vehicle.x, vehicle.y)
    way[1] = row.right >= 0 and is_reachable(road, row.right, vehicle.x, vehicle.y)
    lanes = scenes.ways[b, i].lanes
    # The heading of the way, lane after lane.
    left_m, k, along = TURN_WITHIN_M, BEHIND, s
    turn = 0.0
    while left_m > 0.0 and k < WAY_LANES and lanes[k] >= 0:
        length = road.lanes[lanes[k]].length
        part = min(left_m, max(length - along, 0.0))
        turn += heading_at(road, lanes[k], along + part) - heading_at(road, lanes[k], along)
        left_m -= max(length - along, 0.0)
        along, k = 0.0, k + 1
    way[7] = clip(turn / math.pi, -1.0, 1.0)
    step, to_go, number = vehicle.route_step, row.length - s, lane - row.first
    if step >= vehicle.route_end:
        return
    if vehicle.route_roads[step] != row.first:  # beside its route
        return
    asked, where = 0, 0.0
    for each in range(step, vehicle.route_end):
        first = vehicle.route_roads[each]
        if each > step:
            to_go += road.lanes[first].length
        wanted = vehicle.route_numbers[each]
        if exit_lanes and wanted < 0 and each + 1 < vehicle.route_end:
            following = vehicle.route_roads[each + 1]
            wanted = _exit_lane(road, table, first, following, row.lanes, number)
        if asked == 0 and wanted >= 0 and wanted != number:
            asked, where = wanted - number, to_go
    if asked != 0:
        way[2] = clip(asked / 4.0, -1.0, 1.0)
        way[3] = clip(where / RANGE_M, 0.0, 1.0)
    way[4] = clip(to_go / GOAL_RANGE_M, 0.0, 1.0)


@compiled
def _exit_lane(
    road: Network, table: Conflicts, first: int, following: int, lanes: int, number: int
) -> int:
    """The number of the lane that leads from one road of a route to the next one.

    It is the nearest such lane to lane `number` of a road that has as many `lanes`; -1 if the road
    has another number of them, or nothing leads there.
    """
    row = road.lanes[first]
    if row.lanes != lanes:
        return -1
    for k in range(row.next_roads, row.next_roads + row.next_count):
        if road.successors[k] == following:
            return int(min(max(number, table.leftmost[k]), table.rightmost[k]))
    return -1


@compiled
def _meet(
    scenes: Scenes,
    table: Conflicts,
    b: int,
    i: int,
    meeting: _Meeting,
    way: Observations,
) -> None:
    """Finds the first conflict of each vehicle with the way of vehicle i."""
    road, ego = scenes.road, scenes.vehicles[b, i]
    lanes, starts = scenes.ways[b, i].lanes, scenes.ways[b, i].starts
    s, _ = local_coordinates(road, lanes[BEHIND], ego.x, ego.y)
    x = starts[BEHIND] + s
    meeting.found[:] = False
    for k in range(BEHIND - 1, WAY_LANES):
        lane = lanes[k]
        if lane < 0:
            continue
        if starts[k] - x > RANGE_M:
            break
        for c in range(table.first[lane], table.first[lane + 1]):
            own = starts[k] + table.s[c] - x
            if own < -CLEAR_M or own > RANGE_M:
                continue
            after = lanes[k + 1] if k + 1 < WAY_LANES else -1
            if table.kind[c] == MERGING and after >= 0 and after != table.into[c]:
                continue
            if own > 0.0:
                column = 5 if table.priority[c] == GIVES_WAY else 6
                way[column] = min(way[column], np.float32(own / RANGE_M))
            for j in range(scenes.vehicles.shape[1]):
                vehicle = scenes.vehicles[b, j]
                if j == i or vehicle.kind <= OBSTACLE:
                    continue
                is_known = meeting.found[j] and meeting.own[j] <= own
                if is_known:
                    continue
                other = _distance_to(road, vehicle, table, c)
                if -CLEAR_M <= other <= RANGE_M:
                    meeting.found[j], meeting.conflict[j] = True, c
                    meeting.own[j], meeting.other[j] = own, other


@compiled
def _distance_to(road: Network, vehicle: Row, table: Conflicts, c: int) -> float:
    """How far a vehicle is from a conflict point, m; infinite if its lane does not lead there."""
    for feed in range(table.first_feed[c], table.first_feed[c + 1]):
        if table.feed[feed] == vehicle.lane:
            s, _ = local_coordinates(road, vehicle.lane, vehicle.x, vehicle.y)
            return float(table.to_go[feed] - s)
    lane = table.other[c]
    s, r = local_coordinates(road, lane, vehicle.x, vehicle.y)
    is_beside = abs(r) <= _ON_LANE_M and 0.0 <= s <= road.lanes[lane].length
    if is_beside and math.cos(vehicle.heading - heading_at(road, lane, s)) >= _ON_LANE_COS:
        return float(table.other_s[c] - s)
    return math.inf


@compiled
def _is_hidden(scenes: Scenes, b: int, i: int, j: int) -> bool:
    """Whether the line between the centres of two vehicles passes through a third one."""
    one, other = scenes.vehicles[b, i], scenes.vehicles[b, j]
    for k in range(scenes.vehicles.shape[1]):
        between = scenes.vehicles[b, k]
        if k in (i, j) or between.kind < OBSTACLE:
            continue
        # Along and across the third vehicle, the line is at `start + part * step`.
        first, last = 0.0, 1.0
        for x, y, half in (
            (between.direction_x, between.direction_y, between.length / 2),
            (-between.direction_y, between.direction_x, between.width / 2),
        ):
            start = (one.x - between.x) * x + (one.y - between.y) * y
            step = (other.x - one.x) * x + (other.y - one.y) * y
            if step == 0.0:
                if abs(start) > half:
                    last = -1.0
                continue
            parts = (-half - start) / step, (half - start) / step
            first, last = max(first, min(parts)), min(last, max(parts))
        if first <= last:
            return True
    return False


@compiled
def _write_conflicts(
    scenes: Scenes, table: Conflicts, b: int, i: int, meeting: _Meeting, out: Observations
) -> None:
    """Writes the rows of the vehicles that vehicle i meets, the nearest first."""
    own_s = max(scenes.vehicles[b, i].speed, SLOWEST_MPS)
    for k in range(FIRST_CONFLICT, out.shape[0]):
        best, least = -1, math.inf
        for j in range(meeting.found.size):
            if meeting.found[j] and meeting.own[j] + meeting.other[j] < least:
                best, least = j, meeting.own[j] + meeting.other[j]
        if best < 0:
            return
        meeting.found[best] = False
        c, row, vehicle = meeting.conflict[best], out[k], scenes.vehicles[b, best]
        own, other = meeting.own[best], meeting.other[best]
        own_time = own / own_s
        row[0] = 1.0
        row[1] = clip(own / RANGE_M, -1.0, 1.0)
        row[2] = clip(other / RANGE_M, -1.0, 1.0)
        row[3] = clip(vehicle.speed / SPEED_MPS, -1.0, 1.0)
        row[4] = clip((other / max(vehicle.speed, SLOWEST_MPS) - own_time) / TIME_S, -1.0, 1.0)
        row[5] = table.kind[c] == CROSSING
        row[6] = table.priority[c]
        row[7] = clip(own_time / TIME_S, -1.0, 1.0)
