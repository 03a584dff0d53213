"""highway-env's `roundabout` and `roundabout-generic`."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.meta_actions import index_of
from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, normal, uniform
from charms_bench.roads.layout import WIDTH_M, Edge
from charms_bench.roads.scenes import COMMANDED, IDM, NOTHING, Scenes, put_on_lane
from charms_bench.roads.task import (
    Reward,
    Task,
    draw_behaviour,
    has_space,
    is_on_own_lane,
    plan_route,
    reward_of,
)
from charms_bench.world.actions import LANE_LEFT, LANE_RIGHT
from charms_bench.world.lane_geometry import CIRCULAR, Pair
from charms_bench.world.road import position
from charms_bench.world.road_network import (
    NO_LINE,
    SOLID,
    STRIPED,
    CircularLane,
    SineLane,
    StraightLane,
)

_EXITS = ("exr", "sxr", "nxr")
_GENERIC_EXITS = (*_EXITS, "wxr")
_HALF = 24
"""Half of the angle between an entry and an exit, degrees."""
_RING = {
    "se": ("ex", 90 - _HALF, _HALF),
    "ex": ("ee", _HALF, -_HALF),
    "ee": ("nx", -_HALF, -90 + _HALF),
    "nx": ("ne", -90 + _HALF, -90 - _HALF),
    "ne": ("wx", -90 - _HALF, -180 + _HALF),
    "wx": ("we", -180 + _HALF, -180 - _HALF),
    "we": ("sx", 180 - _HALF, 90 + _HALF),
    "sx": ("se", 90 + _HALF, 90 - _HALF),
}
"""The lanes of the ring by the nodes at their starts, which are the entries (e) and exits (x) in
the south, east, north and west: the nodes at their ends, and from which angle to which they go."""
_AWAY = {"s": (0, 1), "e": (1, 0), "n": (0, -1), "w": (-1, 0)}
"""The directions of the roads that lead away from the ring."""
_SPAWNING = ("we", "sx"), ("sx", "se"), ("ee", "nx"), ("nx", "ne")
_SPAWNING_OUTSIDE = ("eer", "ees"), ("ner", "nes"), ("wer", "wes")
DEVIATION = 2.0
"""Of positions, m, and of speeds, m/s."""
SAFE_DISTANCE_M = 7.0
"""The least distance between vehicles at the start of `roundabout-generic`."""
TRIES = 10
"""How often `roundabout-generic` tries to place a vehicle."""


class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices, and other units are SI."""

    vehicles: int
    own: int
    """The lane on which the ego starts."""
    own_start: float
    """Where on it."""
    destination: int
    """The exit of the vehicles whose exit can be given, -1 if it is drawn."""
    destinations: int


class Roundabout(Task):
    """[`RoundaboutEnv`]"""

    actions = ("DiscreteMetaAction", "DiscreteAction")
    terms = ("collision_reward", "high_speed_reward", "lane_change_reward", "on_road_reward")
    vehicles = 5
    exits: tuple[str, ...] = _EXITS

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        given = config["incoming_vehicle_destination"]
        self._routes = self.layout.routes_to([*self.exits, "nxs"])
        self._lanes = self._start_lanes()
        own = self.lanes["ser", "ses", 0]
        self._rule = Rule(
            self.vehicles,
            own,
            self._own_start(),
            -1 if given is None else range(len(self.exits))[self._exit(given)],
            len(self.exits),
        )

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`RoundaboutEnv._make_road`]"""
        yield from ring(20.0, 2)
        width, entering = 85.0, 0.2 * 85.0
        leaving, pulsation = width - entering, 2 * math.pi / width
        entry = Bend(width / 2 - entering, 7.0, 5.0, pulsation)
        phase = -math.pi / 2 + pulsation * leaving
        way_out = Bend(-width / 2 + leaving, -7.0, 5.0, pulsation, phase)
        for name in _AWAY:
            yield from side(name, width / 2, 170.0, entry, way_out)

    def _exit(self, given: int) -> int:
        """The index of a given exit in `exits`; it may be negative."""
        return given

    def _own_start(self) -> float:
        return 125.0

    def _start_lanes(self) -> Ints:
        inside, entry = self.lanes["we", "sx", 0], self.lanes["eer", "ees", 0]
        return np.array([inside + 1, inside, inside, entry])

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule, self._lanes, self._routes)

    def send(self, scenes: Scenes, b: int, i: int) -> None:
        _send(scenes, b, i, self._rule, self._routes)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, actions, self.reward, rewards)

    def entering(self, scenes: Scenes) -> Ints:
        """The egos (B,)."""
        return np.zeros(len(scenes.vehicles), dtype=np.int64)

    def main_lanes(self, scenes: Scenes) -> Bools:
        """Those of the ring."""
        return np.asarray(scenes.road.lanes["kind"] == CIRCULAR)


class GenericRoundabout(Roundabout):
    """[`RoundaboutGenericEnv`]"""

    exits = _GENERIC_EXITS

    def __init__(self, config: Mapping[str, Any]) -> None:
        self.vehicles = 1 + int(config["vehicles_count"])
        super().__init__(config)

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`RoundaboutGenericEnv._make_road`]"""
        radius, count = config["roundabout_radius"], config["roundabout_lanes"]
        yield from ring(radius, count)
        radius += WIDTH_M * (count - 1)
        width = max(100.0, 2 * radius + 40.0)
        for name, (x, y) in _AWAY.items():
            bends = []
            for node, aside in ((f"{name}e", 2.0), (f"{name}x", -2.0)):
                sine, cosine = maths.sin_cos(math.radians(_RING[node][1]))
                along = x * (radius * cosine) + y * (radius * sine)
                across = y * (radius * cosine) - x * (radius * sine)
                amplitude = (across - aside) / 2
                middle = aside + amplitude if aside > 0 else across - amplitude
                pulsation = math.pi / (width / 2 - along)
                bends.append(Bend(along, middle, amplitude, pulsation))
            yield from side(name, width / 2, width + 40.0, *bends)

    def _exit(self, given: int) -> int:
        return min(given, len(self.exits) - 1)

    def _own_start(self) -> float:
        return float(self.layout.network.lanes["length"][self.lanes["ser", "ses", 0]] - 2.5)

    def _start_lanes(self) -> Ints:
        return np.array([self.lanes[*road, 0] for road in (*_SPAWNING, *_SPAWNING_OUTSIDE)])

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start_generic(scenes, rows, self._rule, self._lanes, self._routes)


class Bend(NamedTuple):
    """A sine between the ring and the straight part of an entry or an exit; SI units."""

    start: float
    """How far from the centre of the ring it starts or ends."""
    aside: float
    """How far its middle is beside the centre, positive on the side of the entry."""
    amplitude: float
    pulsation: float
    phase: float = -math.pi / 2


def ring(radius: float, count: int) -> Iterator[Edge]:
    """The lanes of the ring, the innermost with that radius."""
    for k in range(count):
        if radius + WIDTH_M * k == 0:
            raise InputError(f"config.roundabout_radius: {radius!r}; a lane would be a point")
        left, right = SOLID if k == 0 else NO_LINE, SOLID if k == count - 1 else STRIPED
        for start, (end, first, last) in _RING.items():
            lane = CircularLane(
                center=(0.0, 0.0),
                radius=radius + WIDTH_M * k,
                start_phase=math.radians(first),
                end_phase=math.radians(last),
                clockwise=False,
                line_types=(left, right),
            )
            yield start, end, lane


def side(name: str, near: float, far: float, entry: Bend, way_out: Bend) -> Iterator[Edge]:
    """The entry and the exit on one side, straight from `near` to `far` of the centre."""
    x, y = _AWAY[name]

    def at(along: float, across: float) -> Pair:
        return x * along + y * across, y * along - x * across

    def lane(start: Pair, end: Pair, bend: Bend) -> SineLane:
        return SineLane(
            start=start,
            end=end,
            amplitude=bend.amplitude,
            pulsation=bend.pulsation,
            phase=bend.phase,
            line_types=(SOLID, SOLID),
        )

    lines = STRIPED, SOLID
    straight = StraightLane(start=at(far, 2.0), end=at(near, 2.0), line_types=lines)
    yield f"{name}er", f"{name}es", straight
    into = lane(at(near, entry.aside), at(entry.start, entry.aside), entry)
    yield f"{name}es", f"{name}e", into
    out = lane(at(way_out.start, way_out.aside), at(near, way_out.aside), way_out)
    yield f"{name}x", f"{name}xs", out
    lines = NO_LINE, SOLID
    straight = StraightLane(start=at(near, -2.0), end=at(far, -2.0), line_types=lines)
    yield f"{name}xs", f"{name}xr", straight


@compiled
def put_ego(scenes: Scenes, b: int, rule: Rule, routes: Ints) -> None:
    """Puts the ego at its entry, with the route to the northern exit."""
    put_on_lane(scenes, b, 0, COMMANDED, rule.own, rule.own_start, 8.0)
    plan_route(scenes, b, 0, routes, rule.destinations)


@compiled
def drive_out(scenes: Scenes, b: int, i: int, rule: Rule, routes: Ints, destination: int) -> None:
    """Has a vehicle drive to an exit, which is drawn if it is -1."""
    if destination < 0:
        destination = integers(scenes.generator[b], 0, rule.destinations)
    plan_route(scenes, b, i, routes, destination)
    draw_behaviour(scenes, b, i)


@compiled_of_scenes
def _send(scenes: Scenes, b: int, i: int, rule: Rule, routes: Ints) -> None:
    drive_out(scenes, b, i, rule, routes, -1)


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule, lanes: Ints, routes: Ints) -> None:
    """[`RoundaboutEnv._make_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        put_ego(scenes, b, rule, routes)
        for i, along in enumerate((5.0, 20.0, -20.0, 50.0)):
            s = along + normal(state, 0.0, 1.0) * DEVIATION
            speed = 16.0 + normal(state, 0.0, 1.0) * DEVIATION
            put_on_lane(scenes, b, i + 1, IDM, lanes[i], s, speed)
            drive_out(scenes, b, i + 1, rule, routes, rule.destination if i == 0 else -1)


@compiled_of_scenes
def _start_generic(scenes: Scenes, rows: Ints, rule: Rule, lanes: Ints, routes: Ints) -> None:
    """[`RoundaboutGenericEnv._make_vehicles`]"""
    road = scenes.road
    for b in rows:
        state = scenes.generator[b]
        put_ego(scenes, b, rule, routes)
        count = 1
        for _ in range(rule.vehicles - 1):
            for _ in range(TRIES):
                first = lanes[integers(state, 0, lanes.size)]
                lane = first + integers(state, 0, road.lanes[first].lanes)
                s = uniform(state, 5.0, max(5.0, road.lanes[lane].length - 5.0))
                x, y = position(road, lane, s, 0.0)
                if has_space(scenes, b, count, x, y, SAFE_DISTANCE_M):
                    speed = 14.0 + normal(state, 0.0, 1.0) * DEVIATION
                    put_on_lane(scenes, b, count, IDM, lane, s, speed)
                    drive_out(scenes, b, count, rule, routes, rule.destination)
                    count += 1
                    break
        for i in range(count, rule.vehicles):
            scenes.vehicles[b, i].kind = NOTHING


@compiled_of_scenes
def _judge(scenes: Scenes, rows: Ints, actions: Ints, reward: Reward, out: Floats) -> None:
    """[`RoundaboutEnv._reward`, `RoundaboutEnv._rewards`]"""
    for b in rows:
        ego = scenes.vehicles[b, 0]
        out[b, 1] = ego.crashed
        index = ego.speed_index
        if ego.kind != COMMANDED:
            index = index_of(ego.speed, scenes.target_speeds)
        out[b, 2] = index / 2  # of the default target speeds, whatever they are
        out[b, 3] = actions[b] in (LANE_LEFT, LANE_RIGHT)
        out[b, 4] = is_on_own_lane(scenes, b)
        total = reward_of(reward, out[b], reward.weights[0], reward.weights[1])
        out[b, 0] = total * out[b, 4]
