"""Scenarios on roads that are not straight: where vehicles start, and how prescribed ones move.

A prescribed vehicle follows the middle of its lane, and goes on to the next lane where it ends:
towards its destination, or to the nearest one. It moves to a lane beside it at constant lateral
speed, and as a bicycle does, it moves only as far to the side as it drives.
"""

import math
from collections import defaultdict
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.prescribed import Script, acceleration_at, passed
from charms_bench.engine.stepping import Put
from charms_bench.errors import ScenarioError, suggestion
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes
from charms_bench.roads.layout import Layout
from charms_bench.roads.scenes import COMMANDED, IDM, NOTHING, Scenes, place_near
from charms_bench.roads.settings import layout_on
from charms_bench.roads.task import Task
from charms_bench.world.placement import Location, Placement, Placing, place_of
from charms_bench.world.road import heading_at, local_coordinates, next_lane, position
from charms_bench.world.road_network import Network
from charms_bench.world.scene import SceneSettings


@lru_cache
def way_to(layout: Layout, destination: str | None) -> Ints:
    """(L,) the first lane of the road that follows each lane on the way to a node.

    It is -1 without a destination, at it, and where no way leads there.
    """
    towards, starts = np.full(len(layout.lanes), -1), defaultdict[str, list[str]](list)
    for start, end, _ in layout.lanes:
        starts[end].append(start)
    distance, waiting = {destination: 0}, [destination]
    for node in waiting if destination is not None else ():
        for start in starts[str(node)]:
            if start not in distance:
                distance[start] = distance[node] + 1
                waiting.append(start)
    for (_, end, _), lane in layout.lanes.items():
        known = [each for each in layout.graph.get(end, ()) if each in distance]
        if end != destination and known:
            towards[lane] = layout.lanes[end, min(known, key=distance.__getitem__), 0]
    return towards


class PlacingOnRoad(Placing):
    """Evaluates the formulas of a scenario on the road of its settings."""

    def __init__(self, scenario: Any, settings: SceneSettings, values: Any, count: int) -> None:
        super().__init__(scenario, settings, values, count)
        self._layout, self._home = layout_on(settings)
        self._nodes = {lane: nodes[:2] for nodes, lane in self._layout.lanes.items()}
        self.towards = np.stack([self._way(k, each) for k, each in enumerate(self._starts)])

    def _way(self, i: int, vehicle: Any) -> Ints:
        nodes = {node for start, end, _ in self._layout.lanes for node in (start, end)}
        if vehicle.destination not in (None, *nodes):
            what = f"no node named '{vehicle.destination}'"
            what += f". {suggestion(vehicle.destination, dict.fromkeys(sorted(nodes)))}"
            raise ScenarioError((*place_of(i), "destination"), what)
        return way_to(self._layout, vehicle.destination)

    def _put(self, i: int, at: Location, names: Any, made: Placement) -> None:
        road, vehicle = self._layout.network, self._starts[i]
        first, lanes = road.lanes["first"], road.lanes["lanes"]
        if vehicle.x_m is not None:
            field, begin, way = "x_m", self._first_lane(at, vehicle), self.towards[i]
            name = self._name_of(begin)
            start = begin + self._lane((*at, "lane"), vehicle.lane, lanes[begin], name)
            along = self.within((*at, "x_m"), vehicle.x_m, -np.inf, np.inf)
        elif vehicle.road is not None:
            raise ScenarioError((*at, "road"), "the gap says where the vehicle is; remove one")
        else:
            other, distance = self._from_other(i, at, names, made)
            field, start, way = "gap_m", made.lane[:, other], self.towards[other]
            along = made.x[:, other] + distance
        where, s = along_way(road, way, start, along)
        what = "off the road, or more than once round it: {:g} m from the start of the last lane"
        what += "; expected a smaller distance"
        self._check((*at, field), ~((s >= 0) & (s <= road.lanes["length"][where])), what, s)
        if field == "gap_m":
            named = self._name_of(int(where[0])) if np.ptp(where) == 0 else "its road"
            number = self._lane((*at, "lane"), vehicle.lane, lanes[where], named)
            where, s = beside(road, where, s, first[where] + number)
        made.lane[:, i], made.x[:, i] = where, s
        self._check_destination(i, at, where)

    def _check_destination(self, i: int, at: Location, lanes: Ints) -> None:
        """Rejects a destination to which no way leads from the lanes (R,) of vehicle i."""
        destination = self._starts[i].destination
        for lane in np.unique(lanes).tolist() if destination is not None else ():
            start, end = self._nodes[lane]
            if end == destination or (start != destination and self.towards[i][lane] >= 0):
                continue
            what = f"no way leads from road [{start}, {end}] to '{destination}'"
            if start == destination:
                what = f"'{destination}' is where the vehicle's own road [{start}, {end}] starts"
            raise ScenarioError((*at, "destination"), f"{what}; expected a node ahead of it")

    def _name_of(self, lane: int) -> str:
        """The road of a lane, as a scenario names it."""
        return "road [{}, {}]".format(*self._nodes[lane])

    def _first_lane(self, at: Location, vehicle: Any) -> int:
        """The first lane of the road on which a vehicle is placed."""
        nodes = vehicle.road or self._scenario.ego.road or self._home
        known = {f"[{a}, {b}]": lane for (a, b, k), lane in self._layout.lanes.items() if k == 0}
        if nodes is None:
            what = f"give the road of lane {vehicle.lane}. {suggestion('', known)}"
            raise ScenarioError((*at, "lane"), what)
        name = "[{}, {}]".format(*nodes)
        if name not in known:
            what = f"no road {name}. {suggestion(name, known)}"
            raise ScenarioError((*at, "road"), what)
        return known[name]

    def _between(self, made: Placement, i: int, j: int) -> tuple[Floats, Floats]:
        road = self._layout.network
        x, y, cosine, sine = poses(road, made.lane[:, i], made.x[:, i])
        other_x, other_y, _, _ = poses(road, made.lane[:, j], made.x[:, j])
        dx, dy = other_x - x, other_y - y
        return np.abs(dx * cosine + dy * sine), np.abs(dy * cosine - dx * sine)

    def _y_of(self, lane: NDArray[np.int64]) -> Floats:
        return np.zeros(self._count)  # the lanes of an action are numbers on roads to come


class Motion(NamedTuple):
    """Where the prescribed vehicles [B, N] of a scenario are."""

    lane: Ints
    onto: Ints
    """The lane to which it moves, or `lane`."""
    move: Ints
    """Its last movement, as an index; -1 for none."""
    s: Floats
    """How far along `lane` it is, m."""
    part: Floats
    """The part of the way to `onto` that is behind it, 0 to 1."""
    speed: Floats
    """m/s"""


class RoadScript(Script):
    """The concrete scenarios of B scenes on a road."""

    kind = PlacingOnRoad

    def __init__(self, settings: SceneSettings, scenes: Scenes, task: Task) -> None:
        assert settings.scenario is not None
        count = len(scenes.vehicles)
        super().__init__(settings.scenario, settings, count)
        self._task, self._dt, self._steps = task, 1 / settings.simulation_hz, np.zeros(count, int)
        placing = PlacingOnRoad(settings.scenario, settings, {}, 0)
        self._towards, shape = placing.towards, self._placement.x.shape
        self._motion = Motion(*np.zeros((3, *shape), int), *np.zeros((3, *shape)))
        self._put = Put.empty(scenes.vehicles.shape)

    def place_on(self, scenes: Scenes, rows: Ints, numbers: NDArray[Any]) -> None:
        """Places the vehicles of points with these numbers in the scenes `rows` (R,)."""
        placed, road = self.choose(rows, numbers), scenes.road
        table = scenes.vehicles
        ego = table[rows, 0].copy()
        table["kind"][rows[:, None], np.arange(self._task.vehicles)] = NOTHING
        place_vehicles(scenes, rows, placed)
        home = road.lanes["first"][ego["lane"]] == road.lanes["first"][placed.lane[:, 0]]
        for name in ("route_roads", "route_numbers", "route_step", "route_end", "goal", "goal_s"):
            table[name][rows[home], 0] = ego[name][home]
        others = (each.destination for each in self._scenario.vehicles)
        for i, destination in enumerate((self._scenario.ego.destination, *others)):
            if destination is not None:
                self._task.head_for(scenes, rows, i, destination)
        self._start(rows)

    def _start(self, rows: Ints) -> None:
        motion, placed = self._motion, self._placement
        self._steps[rows] = 0
        motion.lane[rows] = motion.onto[rows] = placed.lane[rows]
        motion.move[rows], motion.part[rows] = -1, 0.0
        motion.s[rows], motion.speed[rows] = placed.x[rows], placed.speed[rows]

    def resume(self, scenes: Scenes, rows: Ints, numbers: NDArray[Any], moves: Bools) -> None:
        """Goes on in the scenes `rows` (R,), in which the vehicles [B, N] marked are prescribed."""
        self.choose(rows, numbers)
        self._start(rows)
        since = np.where(moves, scenes.vehicles["timer_s"], 0.0)[rows].max(axis=1)
        steps = np.round(since / self._dt).astype(int)
        for step in range(steps.max(initial=0)):
            self.put(scenes, rows[step < steps], moves)

    def put(self, scenes: Scenes, rows: Ints, moves: Bools) -> Put:
        """Where the next step ends for the vehicles [B, N] marked in the scenes `rows` (R,)."""
        known = self._placement, self._motion, self._towards
        follow(scenes, rows, moves, *known, self._steps, self._dt, self._put)
        self._steps[rows] += 1
        return self._put

    def show_targets(self, scenes: Scenes) -> None:
        """Has vehicles that move to another lane show it as their target lane."""
        count = self._motion.lane.shape[1]
        moves = self._put.moves[:, :count]
        table = scenes.vehicles["target_lane"]
        table[:, :count] = np.where(moves, self._motion.onto, table[:, :count])


@compiled
def lane_after(road: Network, way: Ints, lane: int) -> int:
    """The lane on which a vehicle goes on at the end of a lane; -1 for none."""
    row = road.lanes[lane]
    if row.next_count == 0:
        return -1
    x, y = position(road, lane, row.length, 0.0)
    return int(next_lane(road, lane, way[lane], -1, x, y))


@compiled
def lane_before(road: Network, way: Ints, lane: int) -> int:
    """The first lane that leads to a lane; -1 for none."""
    for before in range(road.lanes.size):
        if lane_after(road, way, before) == lane:
            return before
    return -1


@compiled
def along_way(road: Network, way: Ints, lanes: Any, s: Floats) -> tuple[Ints, Floats]:
    """The lanes (R,) on which vehicles are so far along their way from the start of lanes (R,).

    Distances end where the road does, and where a ring comes round.
    """
    found, left = np.empty(s.size, dtype=np.int64), s.copy()
    for r in range(s.size):
        lane, passed = lanes[r], np.zeros(road.lanes.size, dtype=np.bool_)
        while left[r] > road.lanes[lane].length:
            after = lane_after(road, way, lane)
            if after < 0 or passed[after]:
                break
            passed[after] = True
            left[r] -= road.lanes[lane].length
            lane = after
        while left[r] < 0.0:
            before = lane_before(road, way, lane)
            if before < 0 or passed[before]:
                break
            passed[before] = True
            lane = before
            left[r] += road.lanes[lane].length
        found[r] = lane
    return found, left


@compiled
def beside(road: Network, lanes: Ints, s: Floats, others: Ints) -> tuple[Ints, Floats]:
    """The places on other lanes (R,) that are beside those on lanes (R,)."""
    found = np.empty(s.size)
    for r in range(s.size):
        x, y = position(road, lanes[r], s[r], 0.0)
        found[r] = local_coordinates(road, others[r], x, y)[0]
    return others, found


@compiled
def poses(road: Network, lanes: Ints, s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Positions (R,) in the middle of lanes (R,), and the cosines and sines of their headings."""
    x, y, cosine, sine = np.empty(s.size), np.empty(s.size), np.empty(s.size), np.empty(s.size)
    for r in range(s.size):
        x[r], y[r] = position(road, lanes[r], s[r], 0.0)
        sine[r], cosine[r] = maths.sin_cos(heading_at(road, lanes[r], s[r]))
    return x, y, cosine, sine


@compiled_of_scenes
def place_vehicles(scenes: Scenes, rows: Ints, placed: Placement) -> None:
    """Puts the vehicles of concrete scenarios (R,) on their lanes."""
    for r in range(rows.size):
        for i in range(placed.x.shape[1]):
            lane, s = placed.lane[r, i], placed.x[r, i]
            x, y = position(scenes.road, lane, s, 0.0)
            heading, kind = heading_at(scenes.road, lane, s), COMMANDED if i == 0 else IDM
            place_near(scenes, rows[r], i, kind, lane, x, y, heading, placed.speed[r, i])
            vehicle = scenes.vehicles[rows[r], i]
            vehicle.length, vehicle.width = placed.length[r, i], placed.width[r, i]
            vehicle.target_speed, vehicle.timer_s = placed.speed[r, i], 0.0


@compiled_of_scenes
def follow(
    scenes: Scenes,
    rows: Ints,
    moves: Bools,
    placed: Placement,
    motion: Motion,
    towards: Ints,
    steps: Ints,
    dt: float,
    put: Put,
) -> None:
    """Moves the prescribed vehicles [B, N] of the scenes `rows` by a step; see `RoadScript.put`."""
    for b in rows:
        time = steps[b] * dt
        for i in range(motion.lane.shape[1]):
            put.moves[b, i] = moves[b, i] and not scenes.vehicles[b, i].crashed
            if not moves[b, i]:
                continue
            aside = drive(scenes.road, placed, motion, towards[i], b, i, time, dt)
            acceleration = acceleration_at(placed, b, i, time, motion.speed[b, i], dt)
            lane, s = motion.lane[b, i], motion.s[b, i]
            x, y, other_x, other_y, _ = ends_of(scenes.road, motion, b, i)
            put.x[b, i] = x + motion.part[b, i] * (other_x - x)
            put.y[b, i] = y + motion.part[b, i] * (other_y - y)
            put.heading[b, i] = heading_at(scenes.road, lane, s) + aside
            motion.speed[b, i] += acceleration * dt
            put.speed[b, i], put.acceleration[b, i] = motion.speed[b, i], acceleration


@compiled
def ends_of(
    road: Network, motion: Motion, b: int, i: int
) -> tuple[float, float, float, float, float]:
    """The points on the lane of a vehicle and on the one to which it moves.

    And how far along the latter it is, m.
    """
    x, y = position(road, motion.lane[b, i], motion.s[b, i], 0.0)
    other_s, _ = local_coordinates(road, motion.onto[b, i], x, y)
    other_x, other_y = position(road, motion.onto[b, i], other_s, 0.0)
    return x, y, other_x, other_y, other_s


@compiled
def drive(
    road: Network,
    placed: Placement,
    motion: Motion,
    way: Ints,
    b: int,
    i: int,
    time: float,
    dt: float,
) -> float:
    """Moves a vehicle along its lane and to the side; returns the angle to its lane, rad."""
    distance, aside = motion.speed[b, i] * dt, 0.0
    for k in range(motion.move[b, i] + 1, placed.moves_at.shape[2]):
        if placed.moves_at[b, i, k] <= time + 1e-9:
            row = road.lanes[motion.lane[b, i]]
            motion.onto[b, i] = row.first + min(placed.moves_to[b, i, k], row.lanes - 1)
            motion.move[b, i], motion.part[b, i] = k, 0.0
    if motion.onto[b, i] != motion.lane[b, i]:
        x, y, other_x, other_y, _ = ends_of(road, motion, b, i)
        dx, dy = other_x - x, other_y - y
        apart = math.sqrt(dx * dx + dy * dy)
        wanted = passed(placed, b, i, motion.move[b, i], time + dt)
        aside = clip((wanted - motion.part[b, i]) * apart, 0.0, distance)
        motion.part[b, i] += aside / max(apart, 1e-9)
    motion.s[b, i] += math.sqrt(distance * distance - aside * aside)
    angle = maths.asin(aside / distance) if aside > 0.0 else 0.0
    angle = angle if motion.onto[b, i] > motion.lane[b, i] else -angle
    if motion.part[b, i] >= 1.0 - 1e-9:
        motion.s[b, i] = ends_of(road, motion, b, i)[-1]
        motion.lane[b, i], motion.part[b, i] = motion.onto[b, i], 0.0
    while motion.s[b, i] >= road.lanes[motion.lane[b, i]].length:
        after = lane_after(road, way, motion.lane[b, i])
        if after < 0:
            break
        lane, onto = motion.lane[b, i], motion.onto[b, i]
        beyond = lane_after(road, way, onto) if onto != lane else after
        # Some of highway-env's lanes begin a little before or after the end of the one before.
        x, y = position(road, lane, motion.s[b, i], 0.0)
        motion.s[b, i], _ = local_coordinates(road, after, x, y)
        is_beside = beyond >= 0 and road.lanes[beyond].first == road.lanes[after].first
        motion.lane[b, i], motion.onto[b, i] = after, beyond if is_beside else after
        motion.part[b, i] = motion.part[b, i] if motion.onto[b, i] != after else 0.0
    return angle
