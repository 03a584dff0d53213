"""A road in a file: vehicles drive from place to place on its lanes, and the ego to a goal.

Goals are roads outside of junctions. The ego's is a road between `NEAREST_M` and half of the way
that it could drive in the time of an episode at its lane's limit. The other vehicles are placed by
density and drive to goals that are drawn from those that they can reach; at its goal, a vehicle
draws the next one. So does a vehicle that comes to the end of a lane that does not lead on along
its way. At an end of the road, a vehicle leaves. It comes back at a start, or on any lane of a road
without starts, as soon as there is space. So do wrecks after `WRECK_S`, and vehicles that have
stood for `STATIONARY_S` and the longest cycle of the map's lights.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.maps.road_map import RoadMap
from charms_bench.roads.fault import NO_RANK
from charms_bench.roads.giving_way import (
    LINE_M,
    MOST_AHEAD,
    RED,
    RED_BEFORE,
    SLOW_MPS,
    Ahead,
    give_way,
    look_along,
)
from charms_bench.roads.goal_states import have_met
from charms_bench.roads.inflow import ENTRY_M
from charms_bench.roads.layout import Edge
from charms_bench.roads.locating import coordinates_of, forget, locate
from charms_bench.roads.looking_ahead import BRAKING_MPS2, speed_ahead
from charms_bench.roads.map_lanes import driven_lanes, indices_of, levels_of, map_of
from charms_bench.roads.meetings import Meetings, meetings_of
from charms_bench.roads.recorded_scenes import enter, on_road, put_recorded, scene_of
from charms_bench.roads.routes import Routes, plan_way, routes_of
from charms_bench.roads.scenes import (
    COMMANDED,
    IDM,
    NOTHING,
    OBSTACLE,
    Here,
    Row,
    Scenes,
    here_of,
    index_of,
    list_by_place,
    place_near,
)
from charms_bench.roads.task import Task, draw_behaviour
from charms_bench.world.named_road import DRAWN
from charms_bench.world.road import heading_at, local_coordinates, position, width_at
from charms_bench.world.scene import Vehicles

MOST_VEHICLES = 2000
NEAREST_M = 100.0
"""The least way to the ego's goal."""
SPACE_M, HEADWAY_S = 8.0, 1.5
"""Around a vehicle that appears, there is as much space, and along its lane as much more time."""
DRAWS, ENTERING_DRAWS = 200, 5
"""So often, a place is drawn at the start, and by a vehicle that comes back."""
NARROW_M = 2.5
"""Where a lane is narrower, such as at its beginning beside others, no vehicle appears."""
BETWEEN_M = 20.0
"""A shorter lane between junctions is part of them: a vehicle that waits there is in the way."""
STATIONARY_MPS = 0.5
WRECK_S, STATIONARY_S = 10.0, 120.0
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


class Lights(NamedTuple):
    """The programs of lights: P phases, light after light."""

    lanes: Ints
    """(P,) the lane for which each phase is."""
    begins: Floats
    """(P,) when it begins, s after the beginning of the program."""
    ends: Floats
    cycles: Floats
    """(P,) how long the program is, s."""
    is_red: Ints
    """(P,) `RED` or `RED_BEFORE`; 0 for green."""


class FileRoad(Task):
    """See the module."""

    terms = ()
    comes_and_goes = True

    def __init__(self, config: Mapping[str, Any]) -> None:
        self.map = map_of(Path(config["file"]), config["sha256"])
        super().__init__(config)
        road = self.layout.network
        self.indices = indices = indices_of(self.map, self.layout)
        """The indices of the lanes by their names in the file."""
        links: list[list[int]] = [[] for _ in indices]
        inside = np.zeros(len(indices), dtype=np.int64)
        for each in self.map.roads:
            for lane in each.lanes:
                links[indices[lane.id]] = [indices[after] for after in lane.successors]
                inside[indices[lane.id]] = bool(each.junction)
        for name, level in levels_of(self.map).items():
            road.lanes["level"][indices[name]] = level
        is_inside = inside > 0
        before: list[list[int]] = [[] for _ in indices]
        for k, following in enumerate(links):
            for after in following:
                before[after].append(k)
        self._lights = _lights(self.map, indices)
        for k in np.nonzero(~is_inside & (road.lanes["length"] < BETWEEN_M))[0].tolist():
            beside = [*links[k], *before[k]]
            inside[k] = bool(links[k] and before[k]) and bool(is_inside[beside].all())
        self.links = links
        self._meetings, self._inside = meetings_of(self.map, indices), inside
        firsts = np.unique(road.lanes["first"])
        outside = firsts[~is_inside[firsts]]
        goals = outside if outside.size else firsts
        self._recorded = None
        if config["start"] != DRAWN:
            scene = scene_of(Path(config["file"]), config["sha256"])
            if scene is None:
                what = "has no recorded vehicles; expected a CommonRoad scenario, or 'drawn'"
                raise InputError(f"config.start: {config['file']} {what}")
            self._recorded = on_road(scene, road, config["start"], self.duration, links)
            self.moments, self.duration = self._recorded.moments, self._recorded.duration
            used = np.concatenate([self._recorded.goals.lane, self._recorded.goals.ego_lane])
            goals = np.union1d(goals, road.lanes["first"][used[used >= 0]])
        self.routes = routes_of(road, links, goals)
        flat = [after for each in links for after in each]
        self._links = np.array(flat, dtype=np.int64)
        self._ends = np.cumsum([len(each) for each in links])
        self._last = np.full(len(links), np.inf)
        for k in [k for k, following in enumerate(links) if not following]:
            along = np.arange(float(road.lanes["length"][k]))
            wide = [width_at(road, k, s) >= NARROW_M for s in along]
            self._last[k] = 1.0 + along[wide].max(initial=LINE_M)
        every = np.nonzero(~is_inside)[0] if outside.size else np.arange(road.lanes.size)
        self._everywhere = _places(every, road.lanes["length"])
        starts = np.setdiff1d(every, self._links)
        self._starts = _places(starts, np.ones(road.lanes.size)) if starts.size else None
        count = round(float(config["density"]) * float(road.lanes["length"].sum()) / 1000)
        if not 0 <= count <= MOST_VEHICLES:
            raise InputError(
                f"config.density: {config['density']:g} vehicles per km are {count:,} vehicles; "
                f"expected 0 to {MOST_VEHICLES:,}"
            )
        self.vehicles = self.egos + count
        if self.moments is not None:
            self.vehicles = self.moments.vehicles.shape[1]
        draws = ENTERING_DRAWS if self.moments is None else 0
        interval, duration = 1 / config["policy_frequency"], min(self.duration, 1e4)
        patience = STATIONARY_S + self._lights.cycles.max(initial=0.0)
        self._rule = Rule(self.egos, self.vehicles, interval, duration, draws, float(patience))
        self.happened = np.zeros((0, 0), dtype=np.int64)
        """(B, N) what happened to each vehicle after the last decision; 0 is nothing."""

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        return driven_lanes(self.map)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        if self._recorded is None:
            _start(scenes, rows, self._rule, self._everywhere, self.routes, self._inside)
        else:
            numbers = np.zeros_like(rows) if self.numbers is None else self.numbers[rows]
            put_recorded(scenes, rows, numbers, self._recorded, self.routes)
        self._regulate(scenes, rows)

    def enter(self, scenes: Scenes, vehicles: Vehicles, numbers: Ints) -> None:
        assert self._recorded is not None
        enter(scenes, vehicles, numbers, self._recorded, self.routes)

    def release_egos(self, scenes: Scenes) -> None:
        """Makes the egos vehicles like the others, for a road without an ego."""
        egos = scenes.vehicles[:, : self.egos]
        egos["kind"] = np.where(egos["kind"] > OBSTACLE, IDM, egos["kind"])
        self._rule = self._rule._replace(egos=0)

    def open_ends(self) -> None:
        """Has vehicles that leave not come back, for a road with an inflow."""
        self._rule = self._rule._replace(entering_draws=0)

    @property
    def starts(self) -> Ints:
        """Those lanes outside of junctions to which no other one leads and that are not narrow."""
        if self._starts is None:
            return np.zeros(0, dtype=np.int64)
        road, lanes = self.layout.network, self._starts.lanes
        wide = [width_at(road, int(lane), ENTRY_M) >= NARROW_M for lane in lanes]
        return lanes[np.array(wide, dtype=np.bool_)]

    def send(self, scenes: Scenes, b: int, i: int) -> None:
        _send(scenes, b, i, self.routes, self._inside)

    def head_for(self, scenes: Scenes, rows: Ints, i: int, destination: str) -> None:
        """Sends it to the end of the first road that leads to the node and is a goal."""
        ends = {first for (_, end, _), first in self.layout.lanes.items() if end == destination}
        goals = [g for g, first in enumerate(self.routes.goals.tolist()) if first in ends]
        if not goals:
            raise InputError(f"destination: no road outside of junctions leads to '{destination}'")
        _head_for(scenes, rows, i, self.routes, goals[0])

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        """There is no reward; environments have their own."""
        rewards[rows] = 0.0

    def follow(self, scenes: Scenes, rows: Ints) -> None:
        if self.happened.shape != scenes.vehicles.shape:
            self.happened = np.zeros(scenes.vehicles.shape, dtype=np.int64)
        starts = self._everywhere if self._starts is None else self._starts
        at_start = self._starts is not None
        lists = self._links, self._ends
        _follow(
            scenes,
            rows,
            self._rule,
            starts,
            at_start,
            lists,
            self.routes,
            self._inside,
            self.happened,
        )
        self._regulate(scenes, rows)

    def _regulate(self, scenes: Scenes, rows: Ints) -> None:
        """Says where vehicles stop."""
        lists, interval = (self._links, self._ends), self._rule.interval
        places = self._meetings, self._inside, self._lights, self._last
        _regulate(scenes, rows, lists, *places, interval)

    def has_reached_goal(self, scenes: Scenes, lanes_before: Ints) -> Bools:
        """Whether each ego (B,) is on the road of its goal, as far along as that is.

        The ego of a planning problem meets one of its goal states.
        """
        if self._recorded is not None and self._recorded.states is not None:
            numbers = np.zeros_like(lanes_before) if self.numbers is None else self.numbers
            rate_hz = float(self._recorded.moments.rate_hz[0])
            return have_met(scenes, numbers, self._recorded.states, rate_hz)
        return _have_reached(scenes, self.routes)

    def ranks(self, scenes: Scenes) -> Ints:
        """The priorities, if the file says who gives way."""
        priority = scenes.road.lanes["priority"]
        known = any(each.gives_way for each in self.map.conflicts)
        return np.where(known, priority, NO_RANK)


def _lights(road: RoadMap, indices: Mapping[str, int]) -> Lights:
    """The programs of a map's lights."""
    found: list[tuple[float, ...]] = []
    inside = {lane.id for each in road.roads if each.junction for lane in each.lanes}
    for each in road.signals:
        cycle = sum(seconds for seconds, _ in each.program)
        for lane in each.lanes:
            begin = 0.0
            for seconds, colour in each.program:
                red = (RED_BEFORE if lane in inside else RED) if colour == "red" else 0
                phase = indices[lane], begin, begin + seconds, cycle, red
                found.append(phase)
                begin += seconds
    lanes, begins, ends, cycles, is_red = np.array(found, np.float64).reshape(-1, 5).T.copy()
    return Lights(lanes.astype(np.int64), begins, ends, cycles, is_red.astype(np.int64))


@compiled
def show_lights(lights: Lights, time: float, is_red: Ints) -> None:
    """Fills in which lanes (L,) have a red light after a time, s."""
    is_red[:] = 0
    for p in range(lights.lanes.size):
        now = time % lights.cycles[p]
        if lights.begins[p] <= now < lights.ends[p] and lights.is_red[p]:
            is_red[lights.lanes[p]] = lights.is_red[p]


def _places(lanes: Ints, weights: Floats) -> Places:
    return Places(lanes, np.cumsum(weights[lanes]))


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
    scenes: Scenes,
    here: Here,
    b: int,
    at: tuple[int, int, float],
    kind: int,
    goal: int,
    routes: Routes,
    inside: Ints,
) -> bool:
    """Puts a vehicle on a lane if there is space, as fast as it may be there.

    `at` is its place, the lane, and how far along it. An IDM vehicle draws its goal. It can stop
    before the next junction; `inside` (L,) says which lanes are in junctions.
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
    vehicle.speed = set_off(scenes, here, b, i, routes, inside, row.length - s)
    if kind == IDM:
        vehicle.target_speed = vehicle.speed
    else:
        vehicle.speed_index = index_of(vehicle.speed, scenes.target_speeds)
        vehicle.target_speed = scenes.target_speeds[vehicle.speed_index]
    return True


@compiled
def set_off(
    scenes: Scenes, here: Here, b: int, i: int, routes: Routes, inside: Ints, left_m: float
) -> float:
    """Gives a vehicle its way, and returns how fast it may be so far from the end of its lane."""
    vehicle = scenes.vehicles[b, i]
    vehicle.speed_min = 0.0
    if vehicle.kind == IDM:
        vehicle.goal = draw_goal(scenes, b, routes, vehicle.lane, 0.0, np.inf)
        draw_behaviour(scenes, b, i)
    plan_way(vehicle, scenes.road, routes, vehicle.lane, True)
    speed = speed_ahead(here, i)
    if vehicle.route_end > 1 and inside[vehicle.route_roads[1]]:
        speed = min(speed, math.sqrt(2 * BRAKING_MPS2 * max(left_m - LINE_M, 0.0)))
    return speed


@compiled_of_scenes
def _send(scenes: Scenes, b: int, i: int, routes: Routes, inside: Ints) -> None:
    """Gives a vehicle that has flowed in a goal."""
    here, vehicle = here_of(scenes, b), scenes.vehicles[b, i]
    forget(here, i)
    left_m = scenes.road.lanes[vehicle.lane].length - coordinates_of(here, i, vehicle.lane).s
    speed = set_off(scenes, here, b, i, routes, inside, left_m)
    vehicle.speed = min(vehicle.speed, speed)


@compiled_of_scenes
def _head_for(scenes: Scenes, rows: Ints, i: int, routes: Routes, goal: int) -> None:
    """Gives a vehicle a goal, and its way there."""
    for b in rows:
        scenes.vehicles[b, i].goal = goal
        plan_way(scenes.vehicles[b, i], scenes.road, routes, scenes.vehicles[b, i].lane, True)


@compiled_of_scenes
def _start(
    scenes: Scenes, rows: Ints, rule: Rule, everywhere: Places, routes: Routes, inside: Ints
) -> None:
    """Places the egos with their goals, and the other vehicles."""
    road, places = scenes.road, scenes.vehicles.shape[1]
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
                if appear(scenes, here, b, (i, lane, s), COMMANDED, goal, routes, inside):
                    scenes.vehicles[b, i].goal_s = goal_s
                    break
        for i in range(rule.egos, rule.vehicles):
            for _ in range(DRAWS):
                lane = draw_lane(state, everywhere)
                s = uniform(state, 0.0, road.lanes[lane].length)
                if appear(scenes, here, b, (i, lane, s), IDM, -1, routes, inside):
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
def _follow(
    scenes: Scenes,
    rows: Ints,
    rule: Rule,
    starts: Places,
    at_start: bool,
    links: tuple[Ints, Ints],
    routes: Routes,
    inside: Ints,
    happened: Ints,
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
                find_route(scenes, b, i, rule, links, routes)
        for i in range(rule.egos, here.places if rule.entering_draws else 0):
            if scenes.vehicles[b, i].kind != NOTHING:
                continue
            for _ in range(rule.entering_draws):
                lane = draw_lane(scenes.generator[b], starts)
                length = scenes.road.lanes[lane].length
                s = min(ENTRY_M, length)
                if not at_start:
                    s = uniform(scenes.generator[b], 0.0, length)
                if appear(scenes, here, b, (i, lane, s), IDM, -1, routes, inside):
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
def find_route(
    scenes: Scenes, b: int, i: int, rule: Rule, links: tuple[Ints, Ints], routes: Routes
) -> None:
    """Gives a vehicle the next steps of its way, and a new goal where it needs one.

    The ego keeps its goal as long as it can reach it.
    """
    road, vehicle = scenes.road, scenes.vehicles[b, i]
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
        flat, ends = links
        begin = ends[lane - 1] if lane > 0 else 0
        if misses and ends[lane] > begin:
            after = flat[integers(scenes.generator[b], begin, ends[lane])]
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


@compiled_of_scenes
def _regulate(
    scenes: Scenes,
    rows: Ints,
    links: tuple[Ints, Ints],
    meetings: Meetings,
    inside: Ints,
    lights: Lights,
    ends: Floats,
    interval: float,
) -> None:
    """Says where the vehicles of the scenes `rows` stop."""
    is_red = np.zeros(scenes.road.lanes.size, dtype=np.int64)
    count = scenes.vehicles.shape[1]
    ahead = Ahead(
        np.zeros((count, MOST_AHEAD), dtype=np.int64),
        np.zeros((count, MOST_AHEAD)),
        np.zeros(count, dtype=np.int64),
        np.zeros(scenes.road.lanes.size, dtype=np.int64),
        np.zeros(count * MOST_AHEAD, dtype=np.int64),
        np.zeros(count),
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=np.bool_),
    )
    for b in rows:
        show_lights(lights, scenes.steps[b] * interval, is_red)
        look_along(scenes, b, links, ahead)
        give_way(scenes, b, meetings, inside, is_red, ends, ahead)


@compiled_of_scenes
def _have_reached(scenes: Scenes, routes: Routes) -> Bools:
    """(B,) whether the first egos have reached their goals."""
    found = np.zeros(scenes.vehicles.shape[0], dtype=np.bool_)
    for b in range(found.size):
        ego = scenes.vehicles[b, 0]
        if ego.goal < 0:
            continue
        if scenes.road.lanes[ego.lane].first == routes.goals[ego.goal]:
            s, _ = local_coordinates(scenes.road, ego.lane, ego.x, ego.y)
            found[b] = s >= ego.goal_s
    return found
