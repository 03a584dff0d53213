"""highway-env's `exit`: leaving a motorway in time."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes
from charms_bench.foundation.generator import choice, uniform
from charms_bench.roads.layout import WIDTH_M, Edge, straight_lanes
from charms_bench.roads.scenes import COMMANDED, IDM, Scenes, put_on_lane
from charms_bench.roads.task import (
    Reward,
    Task,
    head_for,
    plan_route,
    reward_of,
    speed_term,
    wanted_lane,
)
from charms_bench.world.road import local_coordinates
from charms_bench.world.road_network import CircularLane

RADIUS_M = 150.0
"""That of the ramp."""


class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices, and other units are SI."""

    egos: int
    vehicles: int
    """With the egos."""
    main: int
    """The left lane of the first part of the motorway."""
    lanes: int
    exit_lane: int
    exit_ramp: int
    motorway: int
    """The left lane of its last part."""
    ego_spacing: float
    spacing: float
    crowding: float
    """highway-env's factor for all distances; it falls with the number of lanes."""


class Exit(Task):
    """[`ExitEnv`]"""

    terms = ("collision_reward", "goal_reward", "high_speed_reward", "right_lane_reward")
    can_have_egos = True

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        lanes = int(config["lanes_count"])
        self.vehicles = self.egos + int(config["vehicles_count"])
        self._rule = Rule(
            self.egos,
            self.vehicles,
            self.lanes["0", "1", 0],
            lanes,
            self.lanes["1", "2", lanes],
            self.lanes["2", "exit", 0],
            self.lanes["2", "3", 0],
            float(config["ego_spacing"]),
            1 / config["vehicles_density"],
            maths.exp(-5 / 40 * lanes),
        )
        self._routes = self.layout.routes_to(["3"])
        numbers = np.arange(lanes)
        self._weights_of_lanes = numbers / max(numbers.sum(), 1)

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`ExitEnv._create_road`]"""
        count = config["lanes_count"]
        if count == 1 and config["vehicles_count"]:
            raise InputError("config.lanes_count: 1; expected at least 2 for other vehicles")
        for road in (
            straight_lanes("0", "1", count, 0.0, 400.0),
            straight_lanes("1", "2", count + 1, 400.0, 100.0),
            straight_lanes("2", "3", count, 500.0, 500.0),
        ):
            for k, (start, end, lane) in enumerate(road):
                yield start, end, replace(lane, speed_limit=26 - 3.4 * k)
        ramp = CircularLane(
            center=(500.0, WIDTH_M * count + RADIUS_M),
            radius=RADIUS_M,
            start_phase=3 * math.pi / 2,
            end_phase=2 * math.pi,
            forbidden=True,
        )
        yield "2", "exit", ramp

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule, self._routes, self._weights_of_lanes)

    def send(self, scenes: Scenes, b: int, i: int) -> None:
        head_for(scenes, np.array([b]), i, self._routes)
        scenes.vehicles["changes_lanes"][b, i] = False

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, self.reward, self._rule, rewards)

    def navigate(self, scenes: Scenes, rows: Ints) -> None:
        """Has the egos change to the right lane, and to the lane of the exit where it begins."""
        rule = self._rule
        for k in range(self.egos):
            ego = scenes.vehicles[:, k]
            ego["route_roads"][rows, :2] = rule.main, scenes.road.lanes["first"][rule.exit_lane]
            ego["route_numbers"][rows, :2] = rule.lanes - 1, rule.lanes
            ego["route_step"][rows], ego["route_end"][rows] = 0, 2

    def has_reached_goal(self, scenes: Scenes, lanes_before: Ints) -> Bools:
        """Whether each ego (B,) is on the ramp, unless its route goes on along the motorway."""
        vehicles = scenes.vehicles
        found = np.asarray(vehicles["lane"][:, 0] == self._rule.exit_ramp)
        if found.any():
            end = vehicles["route_end"][found, 0]
            last = vehicles["route_roads"][found, 0, end - 1]
            found[found] = (end == 0) | (last != self._rule.motorway)
        return found

    def information(self, scenes: Scenes) -> dict[str, Any]:
        """[`ExitEnv._is_success`]"""
        ego = scenes.vehicles[:, 0]
        lane = np.where(ego["kind"] == COMMANDED, ego["target_lane"], ego["lane"])
        return {"is_success": (lane == self._rule.exit_lane) | (lane == self._rule.exit_ramp)}


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule, routes: Ints, weights: Floats) -> None:
    """[`ExitEnv._create_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        for i in range(rule.egos):
            at = (i, i, COMMANDED, rule.main)
            append(scenes, b, at, 25.0, rule.ego_spacing, rule.crowding)
        for i in range(rule.egos, rule.vehicles):
            lane = rule.main + choice(state, weights)
            speed = scenes.road.lanes[lane].speed_limit
            append(scenes, b, (i, i, IDM, lane), speed, rule.spacing, rule.crowding)
            plan_route(scenes, b, i, routes, 0)
            scenes.vehicles[b, i].changes_lanes = False


@compiled
def append(
    scenes: Scenes,
    b: int,
    at: tuple[int, int, int, int],
    speed: float,
    spacing: float,
    crowding: float,
) -> None:
    """Puts a vehicle on a lane, ahead of all before it [`Vehicle.create_random`].

    Where it comes is its number in highway-env's order, its place, its kind and the lane.
    """
    road, (count, i, kind, lane) = scenes.road, at
    offset = spacing * (12 + 1.0 * speed) * crowding
    s = 3 * offset if count == 0 else -np.inf
    for k in range(count):
        other = scenes.vehicles[b, scenes.order[b, k].place]
        there, _ = local_coordinates(road, lane, other.x, other.y)
        s = max(s, there)
    scenes.order[b, count].place = i
    s += offset * uniform(scenes.generator[b], 0.9, 1.1)
    put_on_lane(scenes, b, i, kind, lane, s, speed)


@compiled_of_scenes
def _judge(scenes: Scenes, rows: Ints, reward: Reward, rule: Rule, out: Floats) -> None:
    """[`ExitEnv._reward`, `ExitEnv._rewards`]"""
    for b in rows:
        ego = scenes.vehicles[b, 0]
        lane = wanted_lane(ego)
        out[b, 1] = ego.crashed
        out[b, 2] = lane == rule.exit_lane or lane == rule.exit_ramp
        out[b, 3] = speed_term(reward, ego.speed)
        out[b, 4] = lane - scenes.road.lanes[lane].first
        total = reward_of(reward, out[b], reward.weights[0], reward.weights[1])
        out[b, 0] = clip(total, 0.0, 1.0) if reward.normalises else total
