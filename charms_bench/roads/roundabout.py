"""highway-env's `roundabout` and `roundabout-generic`."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, normal, uniform
from charms_bench.roads.scenes import COMMANDED, IDM, NOTHING, Scenes, put_on_lane
from charms_bench.roads.task import (
    Task,
    draw_behaviour,
    is_on_own_lane,
    plan_route,
    routes_to,
    share,
    weighted,
)
from charms_bench.world.actions import LANE_LEFT, LANE_RIGHT
from charms_bench.world.lane_geometry import CIRCULAR
from charms_bench.world.road import heading_at, position

_EXITS = ("exr", "sxr", "nxr")
_GENERIC_EXITS = (*_EXITS, "wxr")
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
    normalises: bool


class Roundabout(Task):
    """[`RoundaboutEnv`]"""

    terms = (
        "collision_reward",
        "high_speed_reward",
        "lane_change_reward",
        "on_road_reward",
    )
    vehicles = 5
    exits: tuple[str, ...] = _EXITS

    def __init__(self, config: Mapping[str, Any], network: Any) -> None:
        super().__init__(config, network)
        given = config["incoming_vehicle_destination"]
        self._routes = routes_to(network, [*self.exits, "nxs"])
        self._lanes = self._start_lanes(network)
        own = self.lanes["ser", "ses", 0]
        self._rule = Rule(
            self.vehicles,
            own,
            self._own_start(network),
            -1 if given is None else min(int(given), len(self.exits) - 1),
            len(self.exits),
            bool(config["normalize_reward"]),
        )

    def _own_start(self, network: Any) -> float:
        return 125.0

    def _start_lanes(self, network: Any) -> Ints:
        inside, entry = self.lanes["we", "sx", 0], self.lanes["eer", "ees", 0]
        return np.array([inside + 1, inside, inside, entry])

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule, self._lanes, self._routes)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, actions, self.weights, self._rule, rewards)

    def entering(self, scenes: Scenes) -> Ints:
        """The egos (B,)."""
        return np.zeros(len(scenes.vehicles), dtype=np.int64)

    def main_lanes(self, scenes: Scenes) -> Bools:
        """Those of the ring."""
        return np.asarray(scenes.road.lanes["kind"] == CIRCULAR)


class GenericRoundabout(Roundabout):
    """[`RoundaboutGenericEnv`]"""

    exits = _GENERIC_EXITS

    def __init__(self, config: Mapping[str, Any], network: Any) -> None:
        self.vehicles = 1 + int(config["vehicles_count"])
        super().__init__(config, network)

    def _own_start(self, network: Any) -> float:
        return float(network.get_lane(("ser", "ses", 0)).length - 2.5)

    def _start_lanes(self, network: Any) -> Ints:
        return np.array([self.lanes[*road, 0] for road in (*_SPAWNING, *_SPAWNING_OUTSIDE)])

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start_generic(scenes, rows, self._rule, self._lanes, self._routes)


@compiled
def put_ego(scenes: Scenes, b: int, rule: Rule, routes: Ints) -> None:
    """Puts the ego at its entry, with the route to the northern exit."""
    heading = heading_at(scenes.road, rule.own, rule.own_start)
    put_on_lane(scenes, b, 0, COMMANDED, rule.own, rule.own_start, heading, 8.0)
    plan_route(scenes, b, 0, routes, rule.destinations)


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule, lanes: Ints, routes: Ints) -> None:
    """[`RoundaboutEnv._make_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        put_ego(scenes, b, rule, routes)
        for i, along in enumerate((5.0, 20.0, -20.0, 50.0)):
            s = along + normal(state, 0.0, 1.0) * DEVIATION
            speed = 16.0 + normal(state, 0.0, 1.0) * DEVIATION
            heading = heading_at(scenes.road, lanes[i], s)
            put_on_lane(scenes, b, i + 1, IDM, lanes[i], s, heading, speed)
            destination = rule.destination
            if i > 0 or destination < 0:
                destination = integers(state, 0, rule.destinations)
            plan_route(scenes, b, i + 1, routes, destination)
            draw_behaviour(scenes, b, i + 1)


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
                is_safe = True
                for k in range(count):
                    dx, dy = x - scenes.vehicles[b, k].x, y - scenes.vehicles[b, k].y
                    is_safe &= not math.sqrt(dx * dx + dy * dy) < SAFE_DISTANCE_M
                if is_safe:
                    speed = 14.0 + normal(state, 0.0, 1.0) * DEVIATION
                    put_on_lane(scenes, b, count, IDM, lane, s, heading_at(road, lane, s), speed)
                    destination = rule.destination
                    if destination < 0:
                        destination = integers(state, 0, rule.destinations)
                    plan_route(scenes, b, count, routes, destination)
                    draw_behaviour(scenes, b, count)
                    count += 1
                    break
        for i in range(count, rule.vehicles):
            scenes.vehicles[b, i].kind = NOTHING


@compiled_of_scenes
def _judge(
    scenes: Scenes, rows: Ints, actions: Ints, weights: Floats, rule: Rule, out: Floats
) -> None:
    """[`RoundaboutEnv._reward`, `RoundaboutEnv._rewards`]"""
    for b in rows:
        ego = scenes.vehicles[b, 0]
        out[b, 1] = ego.crashed
        out[b, 2] = ego.speed_index / 2  # of the default target speeds, whatever they are
        out[b, 3] = actions[b] in (LANE_LEFT, LANE_RIGHT)
        out[b, 4] = is_on_own_lane(scenes, b)
        total = weighted(weights, out[b])
        if rule.normalises:
            total = share(total, weights[0], weights[1])
        out[b, 0] = total * out[b, 4]
