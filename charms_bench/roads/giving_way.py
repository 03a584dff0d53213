"""Who goes first where lanes of a road in a file cross or merge, and who stops at a light.

Vehicles look `LOOK_M` along their ways to the places where lanes meet; see `yield_points`. A
vehicle stops before the junction, or before that place if there is no junction or it is in it, as
long as another one is there, or goes first and would come there before the vehicle has left. The
first is

1. a vehicle in the junction, then one that can no longer stop, then any other one,
2. the one whose lane has the right of way, if the map says so and not both have stood for
   `UNUSED_S`, such as in a ring of vehicles that give way to each other,
3. the one that has stood longer or comes earlier: its time to the place less the time for which it
   has stood.

A vehicle also stays out of a junction as long as it would have to stand in it behind another one,
and stops at a red light, and at the end of a lane that leads nowhere while its road goes on. A
vehicle that can no longer stop goes on.
"""

from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled
from charms_bench.roads.routes import Net
from charms_bench.roads.scenes import OBSTACLE, Row, Scenes
from charms_bench.roads.yield_points import GIVES_WAY, UNKNOWN, Meetings
from charms_bench.world.road import local_coordinates
from charms_bench.world.road_network import Network

LOOK_M = 80.0
MOST_AHEAD = 8
"""The most lanes of a way that are looked at."""
LINE_M = 4.0
"""How far before a junction the centre of a vehicle stops."""
SLOW_MPS, CLEAR_M = 2.0, 14.0
"""Behind a vehicle that is slower and less far beyond a junction, there is no room to leave it."""
AWAY_M = 12.0
"""A slow vehicle further away from its junction does not drive there yet."""
UNUSED_S = 10.0
"""A vehicle that has stood for this time does not use its right of way."""
HARD_MPS2 = 4.0
"""What a vehicle brakes with that can only just stop."""
LEAST_MPS, MARGIN_S = 3.0, 1.5
"""With at least this speed, times are predicted; and there is so much between two vehicles."""
MARGIN_M = 0.5
RED, RED_BEFORE = 1, 2
"""A light at the end of a lane, and one before a lane in a junction."""


class Ahead(NamedTuple):
    """The ways of N vehicles for `LOOK_M`, K lanes each, and which vehicles come to each lane."""

    lanes: Ints
    """[N, K]"""
    starts: Floats
    """[N, K] how far ahead each lane starts, m."""
    counts: Ints
    """[N]"""
    first: Ints
    """[L] the first claim on each lane, a number N K; -1 for none."""
    following: Ints
    """[N K] the claim after each claim."""
    turns: Floats
    """[N] when each vehicle is at its next junction, less the time for which it has stood, s."""
    blocked: Ints
    """[N] the lane before the junction that a vehicle has no room to enter; -1 for none."""
    is_red: Ints
    """[L] `RED` or `RED_BEFORE`; 0 without a red light."""
    is_held: Bools
    """[N] whether it does not enter the junction: a wreck, at a red light, without room or in a
    queue."""


@compiled
def room_ahead(vehicles: int, lanes: int) -> Ahead:
    """Arrays for so many vehicles and lanes."""
    shape, count = (vehicles, MOST_AHEAD), vehicles * MOST_AHEAD
    return Ahead(
        np.zeros(shape, np.int64),
        np.zeros(shape),
        np.zeros(vehicles, np.int64),
        np.zeros(lanes, np.int64),
        np.zeros(count, np.int64),
        np.zeros(vehicles),
        np.zeros(vehicles, np.int64),
        np.zeros(lanes, np.int64),
        np.zeros(vehicles, np.bool_),
    )


@compiled
def look_along(scenes: Scenes, b: int, net: Net, ahead: Ahead) -> None:
    """Finds the ways of the vehicles of scene b."""
    road = scenes.road
    ahead.first[:] = -1
    for i in range(scenes.vehicles.shape[1]):
        vehicle, count = scenes.vehicles[b, i], 0
        ahead.counts[i] = 0
        if vehicle.kind <= OBSTACLE:
            continue
        lane = vehicle.lane
        if road.lanes[vehicle.target_lane].first == road.lanes[lane].first:
            lane = vehicle.target_lane
        s, _ = local_coordinates(road, lane, vehicle.x, vehicle.y)
        start, step = -s, vehicle.route_step
        while True:
            ahead.lanes[i, count], ahead.starts[i, count] = lane, start
            claim = i * MOST_AHEAD + count
            ahead.following[claim] = ahead.first[lane]
            ahead.first[lane] = claim
            count += 1
            start += road.lanes[lane].length
            if step < vehicle.route_end and vehicle.route_roads[step] == road.lanes[lane].first:
                step += 1
            if count == MOST_AHEAD or start > LOOK_M or step >= vehicle.route_end:
                break
            lane = lane_after(road, net, lane, vehicle.route_roads[step])
        ahead.counts[i] = count


@compiled
def lane_after(road: Network, net: Net, lane: int, first: int) -> int:
    """The lane of a road to which a lane leads; that with its number if it leads to none."""
    for k in range(net.ends[lane - 1] if lane > 0 else 0, net.ends[lane]):
        if road.lanes[net.links[k]].first == first:
            return int(net.links[k])
    return int(first + min(lane - road.lanes[lane].first, road.lanes[first].lanes - 1))


@compiled
def give_way(
    scenes: Scenes, b: int, meetings: Meetings, inside: Ints, ends: Floats, ahead: Ahead
) -> None:
    """Says where the vehicles of scene b stop.

    `inside` (L,) says which lanes are in junctions, and `ends` (L,) how far along those that lead
    to no other lane can be driven, m.
    """
    for i in range(scenes.vehicles.shape[1]):
        vehicle, start = scenes.vehicles[b, i], 0.0
        for k in range(ahead.counts[i]):
            start = max(ahead.starts[i, k], 0.0)
            if inside[ahead.lanes[i, k]]:
                break
        ahead.turns[i] = start / max(vehicle.speed, LEAST_MPS) - vehicle.stood_s
        ahead.blocked[i] = -1
        for k in range(1, ahead.counts[i]):
            if inside[ahead.lanes[i, k]] and not inside[ahead.lanes[i, k - 1]]:
                if not has_room(scenes, b, i, k, inside, ahead):
                    ahead.blocked[i] = ahead.lanes[i, k - 1]
                break
        ahead.is_held[i] = vehicle.crashed
        end = ahead.starts[i, 1] if ahead.counts[i] > 1 else -np.inf
        if end - LINE_M + MARGIN_M >= braking_way(vehicle):
            is_blocked = ahead.blocked[i] == ahead.lanes[i, 0]
            ahead.is_held[i] |= is_blocked or has_red(i, 0, ahead)
        if vehicle.speed < SLOW_MPS and ahead.counts[i] > 0 and not inside[ahead.lanes[i, 0]]:
            ahead.is_held[i] |= is_behind(i, ahead)
    for i in range(scenes.vehicles.shape[1]):
        scenes.vehicles[b, i].stop_lane = line_lane = -1
        for k in range(ahead.counts[i]):
            lane, start = ahead.lanes[i, k], ahead.starts[i, k]
            if k > 0 and inside[lane] and not inside[ahead.lanes[i, k - 1]]:
                line_lane = ahead.lanes[i, k - 1]
                if ahead.blocked[i] == line_lane:
                    stop(scenes, b, i, line_lane, scenes.road.lanes[line_lane].length - LINE_M)
            line_lane = line_lane if inside[lane] else -1
            begin = meetings.ends[lane - 1] if lane > 0 else 0
            for c in range(begin, meetings.ends[lane]):
                if scenes.vehicles[b, i].stop_lane >= 0:
                    break
                enters = start + meetings.begins[c]
                if enters < 0.0 or enters > LOOK_M:
                    continue
                if waits(scenes, b, (i, k, c), meetings, inside, ahead):
                    if line_lane >= 0:
                        line = scenes.road.lanes[line_lane].length - LINE_M
                        stop(scenes, b, i, line_lane, line)
                    if scenes.vehicles[b, i].stop_lane < 0:
                        stop(scenes, b, i, lane, meetings.begins[c] - MARGIN_M)
            if has_red(i, k, ahead) and scenes.vehicles[b, i].stop_lane < 0:
                stop(scenes, b, i, lane, scenes.road.lanes[lane].length - LINE_M)
            goes_on = scenes.road.lanes[lane].next_count > 0
            if ends[lane] < np.inf and goes_on and scenes.vehicles[b, i].stop_lane < 0:
                stop(scenes, b, i, lane, ends[lane] - LINE_M)
            if scenes.vehicles[b, i].stop_lane >= 0:
                break


@compiled
def has_red(i: int, k: int, ahead: Ahead) -> bool:
    """Whether a light is red at the end of lane number k of the way of vehicle i."""
    if ahead.is_red[ahead.lanes[i, k]] == RED:
        return True
    return bool(k + 1 < ahead.counts[i] and ahead.is_red[ahead.lanes[i, k + 1]] == RED_BEFORE)


@compiled
def is_behind(i: int, ahead: Ahead) -> bool:
    """Whether another vehicle is further along the lane of vehicle i."""
    claim = ahead.first[ahead.lanes[i, 0]]
    while claim >= 0:
        j = claim // MOST_AHEAD
        if j != i and claim % MOST_AHEAD == 0 and ahead.starts[j, 0] < ahead.starts[i, 0]:
            return True
        claim = ahead.following[claim]
    return False


@compiled
def stop(scenes: Scenes, b: int, i: int, lane: int, s: float) -> None:
    """Has a vehicle stop at a place of its way, if it still can."""
    vehicle = scenes.vehicles[b, i]
    if scenes.road.lanes[vehicle.lane].first == scenes.road.lanes[lane].first:
        along, _ = local_coordinates(scenes.road, lane, vehicle.x, vehicle.y)
        if along > s + MARGIN_M or s - along < braking_way(vehicle) - MARGIN_M:
            return
    vehicle.stop_lane, vehicle.stop_s = lane, s


@compiled
def braking_way(vehicle: Row) -> float:
    """The way in which a vehicle can only just stop, m; 0 at standstill."""
    return float(vehicle.speed * max(vehicle.speed, 0.0) / (2 * HARD_MPS2))


@compiled
def has_room(scenes: Scenes, b: int, i: int, k: int, inside: Ints, ahead: Ahead) -> bool:
    """Whether no slow vehicle is on the way of vehicle i through a junction, or just behind it.

    The junction begins with the lane number k of the way.
    """
    while k < ahead.counts[i]:
        lane = ahead.lanes[i, k]
        claim = ahead.first[lane]
        while claim >= 0:
            j, s = claim // MOST_AHEAD, -ahead.starts[claim // MOST_AHEAD, claim % MOST_AHEAD]
            claim = ahead.following[claim]
            is_slow = j != i and scenes.vehicles[b, j].speed < SLOW_MPS
            if is_slow and s >= 0.0 and (inside[lane] or s < CLEAR_M):
                return False
        if not inside[lane]:
            return True
        k += 1
    return True


@compiled
def waits(
    scenes: Scenes, b: int, at: tuple[int, int, int], meetings: Meetings, inside: Ints, ahead: Ahead
) -> bool:
    """Whether a vehicle waits at a place for a vehicle on the other lane.

    `at` is the vehicle, the number of the lane on its way, and the place. Of vehicles that are not
    there yet and are not held, the nearest one counts, because those behind it wait with it.
    """
    i, k, c = at
    own, first, their_k, comes = scenes.vehicles[b, i], -1, 0, np.inf
    claim = ahead.first[meetings.other[c]]
    while claim >= 0:
        j, n = claim // MOST_AHEAD, claim % MOST_AHEAD
        claim = ahead.following[claim]
        begins = ahead.starts[j, n] + meetings.other_begins[c]
        if j == i or ahead.starts[j, n] + meetings.other_until[c] < 0.0:
            continue
        if begins < 0.0:
            return True
        if begins < comes and not ahead.is_held[j] and not is_away(scenes, b, j, n, inside, ahead):
            first, their_k, comes = j, n, begins
    if first < 0 or comes > LOOK_M:
        return False
    other, enters = scenes.vehicles[b, first], ahead.starts[i, k] + meetings.begins[c]
    leaves = ahead.starts[i, k] + meetings.until[c]
    if comes / max(other.speed, LEAST_MPS) > leaves / max(own.speed, LEAST_MPS) + MARGIN_S:
        return False
    rank = rank_of(own, i, k, enters, inside, ahead)
    other_rank = rank_of(other, first, their_k, comes, inside, ahead)
    if rank != other_rank:
        return bool(other_rank > rank)
    is_used = min(own.stood_s, other.stood_s) < UNUSED_S
    if rank != 1 and meetings.order[c] != UNKNOWN and is_used:
        return bool(meetings.order[c] == GIVES_WAY)
    mine, theirs = ahead.turns[i], ahead.turns[first]
    return bool(theirs < mine or (theirs == mine and first < i))


@compiled
def is_away(scenes: Scenes, b: int, j: int, n: int, inside: Ints, ahead: Ahead) -> bool:
    """Whether a slow vehicle does not yet drive to the junction with lane number n of its way."""
    while n > 0 and inside[ahead.lanes[j, n - 1]]:
        n -= 1
    return bool(scenes.vehicles[b, j].speed < SLOW_MPS and ahead.starts[j, n] > AWAY_M)


@compiled
def rank_of(vehicle: Row, i: int, k: int, enters: float, inside: Ints, ahead: Ahead) -> int:
    """2 in the junction of a place, 1 for a vehicle that can no longer stop before it, otherwise 0.

    The place is on the lane number k of the way of vehicle i. A vehicle that has passed the line
    before the junction counts as in it.
    """
    is_inside = True
    for n in range(k + 1):
        is_past = ahead.starts[i, min(n + 1, k)] < LINE_M - MARGIN_M
        is_inside = is_inside and (inside[ahead.lanes[i, n]] > 0 or (is_past and n < k))
    if is_inside:
        return 2
    return 1 if enters < braking_way(vehicle) else 0
