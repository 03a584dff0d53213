"""highway-env's `racetrack`, `racetrack-large` and `racetrack-oval`: following a track."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads.controls import kind_of_ego
from charms_bench.roads.scenes import IDM, NOTHING, Scenes, put_on_lane
from charms_bench.roads.task import Task, is_on_own_lane, share
from charms_bench.world.lane_geometry import STRAIGHT
from charms_bench.world.road import heading_at, local_coordinates, position

SAFE_DISTANCE_M = 20.0
"""A vehicle that would start closer to another is left out."""


class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices, and other units are SI."""

    ego: int
    """The kind of the ego."""
    own: int
    """The first of the lanes on which the ego can start."""
    own_lanes: int
    ahead: int
    """The first lane of the road after it, on which there is another vehicle."""
    others: int
    """There are fewer vehicles than this besides these two."""
    centring_cost: float
    """By which a distance from the centre of the lane is punished, 1/m^2."""


class Racetrack(Task):
    """[`RacetrackEnv`, `RacetrackEnvLarge`]"""

    terms = ("lane_centering_reward", "action_reward", "collision_reward", "on_road_reward")
    actions = ("ContinuousAction", "DiscreteAction")
    takes_types = False
    start_lanes = 2

    def __init__(self, config: Mapping[str, Any], network: Any) -> None:
        super().__init__(config, network)
        self.vehicles = 1 + int(config["other_vehicles"])
        self._rule = Rule(
            kind_of_ego(config),
            self.lanes["a", "b", 0],
            self.start_lanes,
            self.lanes["b", "c", 0],
            int(config["other_vehicles"]),
            float(config["lane_centering_cost"]),
        )
        roads = [
            [self.lanes[start, end, 0] for end in ends] for start, ends in network.graph.items()
        ]
        self._roads = np.array([road for each in roads for road in each])
        self._nodes = np.cumsum([0, *map(len, roads)])
        self._action_weight = config["action_reward"]
        self._ends_off_road = bool(config["terminate_off_road"])
        self._on_road: Bools = np.ones(0, dtype=np.bool_)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule, self._nodes, self._roads)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        norms = np.linalg.norm(actions.reshape(len(actions), -1), axis=1)
        costs = (self._action_weight * norms).astype(np.float64)
        is_single = norms.dtype == np.float32
        rewards[:, 2] = norms
        _judge(scenes, rows, costs, is_single, self.weights, self._rule, rewards)
        self._on_road = rewards[:, 4] > 0

    def is_terminated(self, scenes: Scenes) -> Bools:
        crashed = super().is_terminated(scenes)
        return crashed | ~self._on_road if self._ends_off_road else crashed


class OvalRacetrack(Racetrack):
    """[`RacetrackEnvOval`]"""

    def __init__(self, config: Mapping[str, Any], network: Any) -> None:
        for key in ("length", "no_lanes"):
            if not config[key] > 0:
                what = "highway-env draws it without a seed"
                raise InputError(f"config.{key}: {config[key]!r} is not supported: {what}")
        self.start_lanes = int(config["no_lanes"])
        super().__init__(config, network)


@compiled
def draw_lane(scenes: Scenes, b: int, nodes: Ints, roads: Ints) -> int:
    """Any lane [`RoadNetwork.random_lane_index`]; the roads of node k start at `nodes[k]`."""
    state = scenes.generator[b]
    node = integers(state, 0, nodes.size - 1)
    first = roads[integers(state, nodes[node], nodes[node + 1])]
    return int(first + integers(state, 0, scenes.road.lanes[first].lanes))


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule, nodes: Ints, roads: Ints) -> None:
    """[`RacetrackEnv._make_vehicles`]"""
    road = scenes.road
    for b in rows:
        state = scenes.generator[b]
        number = integers(state, 0, rule.own_lanes)
        lane, s = rule.own + number, uniform(state, 20.0, 50.0)
        heading, speed = heading_at(road, lane, s), road.lanes[lane].speed_limit
        put_on_lane(scenes, b, 0, rule.ego, lane, s, heading, speed)
        count = 1
        if rule.others > 0:
            lane, s = rule.ahead + number, uniform(state, 0.0, road.lanes[rule.ahead].length)
            speed = 6.0 + uniform(state, 0.0, 3.0)
            put_on_lane(scenes, b, 1, IDM, lane, s, heading_at(road, lane, s), speed)
            count = 2
            for _ in range(integers(state, 0, rule.others)):
                lane = draw_lane(scenes, b, nodes, roads)
                s = uniform(state, 0.0, road.lanes[lane].length)
                speed = 6.0 + uniform(state, 0.0, 3.0)
                x, y = position(road, lane, s, 0.0)
                is_free = True
                for k in range(count):
                    dx, dy = x - scenes.vehicles[b, k].x, y - scenes.vehicles[b, k].y
                    is_free &= not math.sqrt(dx * dx + dy * dy) < SAFE_DISTANCE_M
                if is_free:
                    put_on_lane(scenes, b, count, IDM, lane, s, heading_at(road, lane, s), speed)
                    count += 1
        for i in range(count, 1 + rule.others):
            scenes.vehicles[b, i].kind = NOTHING


@compiled_of_scenes
def _judge(
    scenes: Scenes,
    rows: Ints,
    costs: Floats,
    is_single: bool,
    weights: Floats,
    rule: Rule,
    out: Floats,
) -> None:
    """[`RacetrackEnv._reward`, `RacetrackEnv._rewards`]

    On a straight lane, highway-env adds the rewards for actions of single precision in single
    precision.
    """
    for b in rows:
        ego = scenes.vehicles[b, 0]
        _, beside = local_coordinates(scenes.road, ego.lane, ego.x, ego.y)
        out[b, 1] = 1 / (1 + rule.centring_cost * (beside * beside))
        out[b, 3] = ego.crashed
        out[b, 4] = is_on_own_lane(scenes, b)
        centring, crash = weights[0] * out[b, 1], weights[2] * out[b, 3]
        if is_single and scenes.road.lanes[ego.lane].kind == STRAIGHT:
            single = np.float32(centring) + np.float32(costs[b]) + np.float32(crash)
            total = np.float64(single)
        else:
            total = centring + costs[b] + crash
        out[b, 0] = share(total, weights[2], 1.0) * out[b, 4]
