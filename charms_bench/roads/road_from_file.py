"""A road in a file: vehicles drive from place to place on its lanes, and the ego to a goal.

Goals are roads outside of junctions. The ego's is a road between `NEAREST_M` and half of the way
that it could drive in the time of an episode at its lane's limit. The other vehicles are placed by
density and drive to goals that are drawn from those that they can reach; at its goal, a vehicle
draws the next one. So does a vehicle that comes to the end of a lane that does not lead on along
its way. At an end of the road, a vehicle leaves. It comes back at a start, or on any lane of a road
without starts, as soon as there is space. So do wrecks after `WRECK_S`, and vehicles that have
stood for `STATIONARY_S` and the longest cycle of the map's lights.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.maps.road_map import RoadMap
from charms_bench.roads.fault import NO_RANK
from charms_bench.roads.giving_way import (
    LINE_M,
    RED,
    RED_BEFORE,
    give_way,
    look_along,
    room_ahead,
)
from charms_bench.roads.goal_states import have_met
from charms_bench.roads.inflow import ENTRY_M
from charms_bench.roads.layout import Edge
from charms_bench.roads.map_lanes import driven_lanes, indices_of, levels_of, map_of
from charms_bench.roads.recorded_scenes import enter, put_recorded, recorded_on, scene_of
from charms_bench.roads.routes import Net, Routes, routes_of
from charms_bench.roads.scenes import IDM, OBSTACLE, Scenes
from charms_bench.roads.task import Task
from charms_bench.roads.traffic_renewal import (
    NARROW_M,
    Places,
    Rule,
    aim_at,
    come_and_go,
    place_all,
    send_on,
)
from charms_bench.roads.yield_points import Meetings, meetings_of
from charms_bench.world.named_road import DRAWN
from charms_bench.world.road import local_coordinates, width_at
from charms_bench.world.scene import Vehicles

MOST_VEHICLES = 2000
BETWEEN_M = 20.0
"""A shorter lane between junctions is part of them: a vehicle that waits there is in the way."""
STATIONARY_S = 120.0
ENTERING_DRAWS = 5
"""So often, a vehicle that comes back draws a place."""


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
        self._meetings = meetings_of(self.map, indices)
        firsts = np.unique(road.lanes["first"])
        outside = firsts[~is_inside[firsts]]
        goals = outside if outside.size else firsts
        self._recorded = None
        if config["start"] != DRAWN:
            scene = scene_of(Path(config["file"]), config["sha256"])
            if scene is None:
                what = "has no recorded vehicles; expected a CommonRoad scenario, or 'drawn'"
                raise InputError(f"config.start: {config['file']} {what}")
            self._recorded = recorded_on(scene, road, config["start"], self.duration, links)
            self.moments, self.duration = self._recorded.moments, self._recorded.duration
            used = np.concatenate([self._recorded.goals.lane, self._recorded.goals.ego_lane])
            goals = np.union1d(goals, road.lanes["first"][used[used >= 0]])
        self.routes = routes_of(road, links, goals)
        flat = [after for each in links for after in each]
        ends = np.cumsum([len(each) for each in links])
        self._net = Net(self.routes, inside, np.array(flat, dtype=np.int64), ends)
        self._last = np.full(len(links), np.inf)
        for k in [k for k, following in enumerate(links) if not following]:
            along = np.arange(float(road.lanes["length"][k]))
            wide = [width_at(road, k, s) >= NARROW_M for s in along]
            self._last[k] = 1.0 + along[wide].max(initial=LINE_M)
        every = np.nonzero(~is_inside)[0] if outside.size else np.arange(road.lanes.size)
        self._everywhere = _places(every, road.lanes["length"])
        starts = np.setdiff1d(every, flat)
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
            place_all(scenes, rows, self._rule, self._everywhere, self._net)
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
        send_on(scenes, b, i, self._net)

    def head_for(self, scenes: Scenes, rows: Ints, i: int, destination: str) -> None:
        """Sends it to the end of the first road that leads to the node and is a goal."""
        ends = {first for (_, end, _), first in self.layout.lanes.items() if end == destination}
        goals = [g for g, first in enumerate(self.routes.goals.tolist()) if first in ends]
        if not goals:
            raise InputError(f"destination: no road outside of junctions leads to '{destination}'")
        aim_at(scenes, rows, i, self.routes, goals[0])

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        """There is no reward; environments have their own."""
        rewards[rows] = 0.0

    def follow(self, scenes: Scenes, rows: Ints) -> None:
        if self.happened.shape != scenes.vehicles.shape:
            self.happened = np.zeros(scenes.vehicles.shape, dtype=np.int64)
        starts, at_start = self._starts or self._everywhere, self._starts is not None
        come_and_go(scenes, rows, self._rule, starts, at_start, self._net, self.happened)
        self._regulate(scenes, rows)

    def _regulate(self, scenes: Scenes, rows: Ints) -> None:
        """Says where vehicles stop."""
        of_road = self._net, self._meetings, self._lights, self._last
        _regulate(scenes, rows, *of_road, self._rule.interval)

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


@compiled_of_scenes
def _regulate(
    scenes: Scenes,
    rows: Ints,
    net: Net,
    meetings: Meetings,
    lights: Lights,
    ends: Floats,
    interval: float,
) -> None:
    """Says where the vehicles of the scenes `rows` stop."""
    ahead = room_ahead(scenes.vehicles.shape[1], scenes.road.lanes.size)
    for b in rows:
        show_lights(lights, scenes.steps[b] * interval, ahead.is_red)
        look_along(scenes, b, net, ahead)
        give_way(scenes, b, meetings, net.inside, ends, ahead)


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
