"""How vehicles on a road in a file appear, find their ways, leave and come back, compiled.

`road_from_file` says by which rules.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from charms_bench.engine.meta_actions import index_of
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads.giving_way import LINE_M, SLOW_MPS
from charms_bench.roads.inflow import ENTRY_M
from charms_bench.roads.locating import coordinates_of, forget, locate
from charms_bench.roads.looking_ahead import BRAKING_MPS2, speed_ahead
from charms_bench.roads.routes import Net, Routes, plan_way
from charms_bench.roads.scenes import (
    COMMANDED,
    IDM,
    NOTHING,
    OBSTACLE,
    Here,
    Row,
    Scenes,
    here_of,
    list_by_place,
    place_near,
)
from charms_bench.roads.task import draw_behaviour
from charms_bench.world.road import heading_at, local_coordinates, position, width_at

NEAREST_M = 100.0
"""The least way to the ego's goal."""
SPACE_M, HEADWAY_S = 8.0, 1.5
"""Around a vehicle that appears, there is as much space, and along its lane as much more time."""
DRAWS = 200
"""So often, a place is drawn at the start."""
NARROW_M = 2.5
"""Where a lane is narrower, such as at its beginning beside others, no vehicle appears."""
STATIONARY_MPS = 0.5
WRECK_S = 10.0
LEFT, CLEARED, FREED, ENTERED = range(1, 5)
"""What happens to a vehicle after a decision: it leaves, as a wreck, or after it has stood for a
long time; or it comes back."""


class Rule(NamedTuple):
    """What the functions below need to know."""

    egos: int
    vehicles: int
    """With the egos, at the start."""
    interval: float
    """Between decisions, s."""
    duration: float
    entering_draws: int
    """How often a vehicle that comes back draws a place; 0 if none does."""
    patience: float
    """A vehicle that has stood for longer is taken out, s."""


class Places(NamedTuple):
    """Where vehicles appear: lanes, and the sums of their lengths up to each."""

    lanes: Ints
    until: Floats


@compiled
def draw_lane(state: Any, places: Places) -> int:
    """A lane, by the weights of the lanes."""
    k = int(np.searchsorted(places.until, uniform(state, 0.0, places.until[-1])))
    return int(places.lanes[min(k, places.lanes.size - 1)])


@compiled
def draw_goal(
    scenes: Scenes, b: int, routes: Routes, lane: int, nearest: float, furthest: float
) -> int:
    """A goal at so long a way from the start of a lane, on another road; -1 if there is none."""
    first, count = scenes.road.lanes[lane].first, 0
    for g in range(routes.goals.size):
        is_other = routes.goals[g] != first
        count += is_other and nearest <= routes.distance[g, lane] < furthest
    if count == 0:
        return -1
    number = integers(scenes.generator[b], 0, count)
    for g in range(routes.goals.size):
        is_other = routes.goals[g] != first
        if is_other and nearest <= routes.distance[g, lane] < furthest:
            if number == 0:
                return g
            number -= 1
    return -1


@compiled
def is_free(scenes: Scenes, b: int, i: int, lane: int, s: float) -> bool:
    """Whether there is space for vehicle i on a lane, at its limit as the speed."""
    road = scenes.road
    x, y = position(road, lane, s, 0.0)
    limit, half = road.lanes[lane].speed_limit, width_at(road, lane, s) / 2
    if half < NARROW_M / 2:
        return False
    for j in range(scenes.vehicles.shape[1]):
        other = scenes.vehicles[b, j]
        dx, dy = other.x - x, other.y - y
        away = math.sqrt(dx * dx + dy * dy)
        along = SPACE_M + HEADWAY_S * max(limit, other.speed)
        if j == i or other.kind == NOTHING or away > along:
            continue
        if away < SPACE_M or abs(local_coordinates(road, lane, other.x, other.y)[1]) < half:
            return False
    return True


@compiled
def appear(
    scenes: Scenes, here: Here, b: int, at: tuple[int, int, float], kind: int, goal: int, net: Net
) -> bool:
    """Puts a vehicle on a lane if there is space, as fast as it may be there.

    `at` is its place, the lane, and how far along it. An IDM vehicle draws its goal. It can stop
    before the next junction.
    """
    i, lane, s = at
    row = scenes.road.lanes[lane]
    speed = row.speed_limit
    x, y = position(scenes.road, lane, s, 0.0)
    if not is_free(scenes, b, i, lane, s):
        return False
    place_near(scenes, b, i, kind, lane, x, y, heading_at(scenes.road, lane, s), speed)
    vehicle = scenes.vehicles[b, i]
    locate(here, i)
    vehicle.target_lane, vehicle.goal = vehicle.lane, goal
    vehicle.speed = set_off(scenes, here, b, i, net, row.length - s)
    if kind == IDM:
        vehicle.target_speed = vehicle.speed
    else:
        vehicle.speed_index = index_of(vehicle.speed, scenes.target_speeds)
        vehicle.target_speed = scenes.target_speeds[vehicle.speed_index]
    return True


@compiled
def set_off(scenes: Scenes, here: Here, b: int, i: int, net: Net, left_m: float) -> float:
    """Gives a vehicle its way, and returns how fast it may be so far from the end of its lane."""
    vehicle = scenes.vehicles[b, i]
    vehicle.speed_min = 0.0
    if vehicle.kind == IDM:
        vehicle.goal = draw_goal(scenes, b, net.routes, vehicle.lane, 0.0, np.inf)
        draw_behaviour(scenes, b, i)
    plan_way(vehicle, scenes.road, net.routes, vehicle.lane, True)
    speed = speed_ahead(here, i)
    if vehicle.route_end > 1 and net.inside[vehicle.route_roads[1]]:
        speed = min(speed, math.sqrt(2 * BRAKING_MPS2 * max(left_m - LINE_M, 0.0)))
    return speed


@compiled_of_scenes
def send_on(scenes: Scenes, b: int, i: int, net: Net) -> None:
    """Gives a vehicle that has flowed in a goal."""
    here, vehicle = here_of(scenes, b), scenes.vehicles[b, i]
    forget(here, i)
    left_m = scenes.road.lanes[vehicle.lane].length - coordinates_of(here, i, vehicle.lane).s
    speed = set_off(scenes, here, b, i, net, left_m)
    vehicle.speed = min(vehicle.speed, speed)


@compiled_of_scenes
def aim_at(scenes: Scenes, rows: Ints, i: int, routes: Routes, goal: int) -> None:
    """Gives a vehicle a goal, and its way there."""
    for b in rows:
        scenes.vehicles[b, i].goal = goal
        plan_way(scenes.vehicles[b, i], scenes.road, routes, scenes.vehicles[b, i].lane, True)


@compiled_of_scenes
def place_all(scenes: Scenes, rows: Ints, rule: Rule, everywhere: Places, net: Net) -> None:
    """Places the egos with their goals, and the other vehicles."""
    routes, road, places = net.routes, scenes.road, scenes.vehicles.shape[1]
    for b in rows:
        state, here = scenes.generator[b], here_of(scenes, b)
        scenes.steps[b] = 0
        for i in range(places):
            scenes.vehicles[b, i].kind = NOTHING
            scenes.order[b, i].place = i
            forget(here, i)
        for i in range(rule.egos):
            for attempt in range(DRAWS):
                lane = draw_lane(state, everywhere)
                row = road.lanes[lane]
                s = uniform(state, 0.0, row.length)
                most = 0.5 * rule.duration * row.speed_limit
                goal = draw_goal(scenes, b, routes, lane, s + NEAREST_M, s + most)
                is_last = attempt == DRAWS - 1
                if goal < 0 and not is_last and (attempt < DRAWS // 2 or row.length < NEAREST_M):
                    continue
                goal_s = 0.0
                if goal < 0:  # it is the end of its own road, or as far as it can get
                    goal, goal_s = own_goal(routes, row.first), min(s + most, row.length)
                if appear(scenes, here, b, (i, lane, s), COMMANDED, goal, net):
                    scenes.vehicles[b, i].goal_s = goal_s
                    break
        for i in range(rule.egos, rule.vehicles):
            for _ in range(DRAWS):
                lane = draw_lane(state, everywhere)
                s = uniform(state, 0.0, road.lanes[lane].length)
                if appear(scenes, here, b, (i, lane, s), IDM, -1, net):
                    break
        list_by_place(scenes, b)


@compiled
def own_goal(routes: Routes, first: int) -> int:
    """The goal that is a road; -1 if it is none."""
    for g in range(routes.goals.size):
        if routes.goals[g] == first:
            return g
    return -1


@compiled_of_scenes
def come_and_go(
    scenes: Scenes, rows: Ints, rule: Rule, starts: Places, at_start: bool, net: Net, happened: Ints
) -> None:
    """Has vehicles find their ways, leave and come back; see the module."""
    for b in rows:
        here, has_changed = here_of(scenes, b), False
        scenes.steps[b] += 1
        for i in range(here.places):
            forget(here, i)
            vehicle = scenes.vehicles[b, i]
            happened[b, i] = 0
            if not is_stationary(vehicle):
                vehicle.stood_s *= abs(vehicle.speed) < SLOW_MPS
            else:
                vehicle.stood_s += rule.interval
            if i >= rule.egos and vehicle.kind > OBSTACLE and vehicle.checks_collisions:
                happened[b, i] = fate(scenes, b, i, rule)
                if happened[b, i] > 0:
                    vehicle.kind, has_changed = NOTHING, True
            if vehicle.kind > OBSTACLE:
                find_route(scenes, b, i, rule, net)
        for i in range(rule.egos, here.places if rule.entering_draws else 0):
            if scenes.vehicles[b, i].kind != NOTHING:
                continue
            for _ in range(rule.entering_draws):
                lane = draw_lane(scenes.generator[b], starts)
                length = scenes.road.lanes[lane].length
                s = min(ENTRY_M, length)
                if not at_start:
                    s = uniform(scenes.generator[b], 0.0, length)
                if appear(scenes, here, b, (i, lane, s), IDM, -1, net):
                    has_changed = True
                    if happened[b, i] == 0:
                        happened[b, i] = ENTERED
                    break
        if has_changed:
            list_by_place(scenes, b)


@compiled
def is_stationary(vehicle: Row) -> bool:
    """Whether a vehicle stands, or is a wreck."""
    return bool(vehicle.crashed or abs(vehicle.speed) < STATIONARY_MPS)


@compiled
def fate(scenes: Scenes, b: int, i: int, rule: Rule) -> int:
    """What happens to a vehicle that is there; 0 if it stays."""
    vehicle = scenes.vehicles[b, i]
    if vehicle.crashed:
        return CLEARED if vehicle.stood_s >= WRECK_S else 0
    if vehicle.stood_s >= rule.patience:
        return FREED
    row = scenes.road.lanes[vehicle.lane]
    s, _ = local_coordinates(scenes.road, vehicle.lane, vehicle.x, vehicle.y)
    is_at_end = s >= row.length - max(vehicle.speed, 0.0) * rule.interval
    return LEFT if row.next_count == 0 and is_at_end else 0


@compiled
def find_route(scenes: Scenes, b: int, i: int, rule: Rule, net: Net) -> None:
    """Gives a vehicle the next steps of its way, and a new goal where it needs one.

    The ego keeps its goal as long as it can reach it.
    """
    road, vehicle, routes = scenes.road, scenes.vehicles[b, i], net.routes
    lane = vehicle.lane
    if road.lanes[vehicle.target_lane].first == road.lanes[lane].first:
        lane = vehicle.target_lane
    row = road.lanes[lane]
    if i >= rule.egos and (vehicle.goal < 0 or routes.goals[vehicle.goal] == row.first):
        vehicle.goal = draw_goal(scenes, b, routes, lane, 0.0, np.inf)
    s, _ = local_coordinates(road, lane, vehicle.x, vehicle.y)
    is_at_end = row.length - s < max(vehicle.speed, 0.0) * rule.interval + ENTRY_M
    if vehicle.goal >= 0 and is_at_end and vehicle.lane == vehicle.target_lane:
        misses = routes.free[vehicle.goal, lane] == 0.0
        misses = misses or not routes.distance[vehicle.goal, lane] < np.inf
        begin = net.ends[lane - 1] if lane > 0 else 0
        if misses and net.ends[lane] > begin:
            after = net.links[integers(scenes.generator[b], begin, net.ends[lane])]
            is_lost = not routes.distance[vehicle.goal, after] < np.inf
            if i >= rule.egos or is_lost:
                vehicle.goal = draw_goal(scenes, b, routes, after, 0.0, np.inf)
            plan_way(vehicle, road, routes, after, False)
            step_before(vehicle, row.first, lane - row.first)
            return
    plan_way(vehicle, road, routes, lane, True)


@compiled
def step_before(vehicle: Any, first: int, number: int) -> None:
    """Puts a step before those of a vehicle's route, of which the last may be dropped."""
    count = min(vehicle.route_end + 1, vehicle.route_roads.size)
    for k in range(count - 1, 0, -1):
        vehicle.route_roads[k] = vehicle.route_roads[k - 1]
        vehicle.route_numbers[k] = vehicle.route_numbers[k - 1]
    vehicle.route_roads[0], vehicle.route_numbers[0] = first, number
    vehicle.route_end = count
