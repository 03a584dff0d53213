"""highway-env's `two-way`: overtaking on a road with oncoming traffic."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.foundation.generator import normal
from charms_bench.roads.layout import WIDTH_M, Edge
from charms_bench.roads.scenes import COMMANDED, IDM, Scenes, put_on_lane
from charms_bench.roads.task import Task, weighted
from charms_bench.world.road_network import NO_LINE, SOLID_LINE, STRIPED, StraightLane

LENGTH_M = 800.0
GOAL_M = 780.0
"""The ego should get this far, which is just before the end of the road."""


class TwoWay(Task):
    """[`TwoWayEnv`]"""

    actions = ("DiscreteMetaAction",)
    terms = ("high_speed_reward", "left_lane_reward")
    vehicles = 6

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        self._own, self._oncoming = self.lanes["a", "b", 1], self.lanes["b", "a", 0]

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`TwoWayEnv._make_road`]"""
        for y, lines in ((0.0, (SOLID_LINE, STRIPED)), (WIDTH_M, (NO_LINE, SOLID_LINE))):
            yield "a", "b", StraightLane(start=(0.0, y), end=(LENGTH_M, y), line_types=lines)
        back = StraightLane(start=(LENGTH_M, 0.0), end=(0.0, 0.0), line_types=(NO_LINE, NO_LINE))
        yield "b", "a", back

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._own, self._oncoming)

    def has_reached_goal(self, scenes: Scenes, lanes_before: Ints) -> Bools:
        """Whether each ego (B,) is at the end of the road, in the direction in which it drives."""
        x, lane = (scenes.vehicles[name][:, 0] for name in ("x", "lane"))
        return np.where(lane == self._oncoming, x < LENGTH_M - GOAL_M, x > GOAL_M)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, self.reward.weights, rewards)


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, own: int, oncoming: int) -> None:
    """[`TwoWayEnv._make_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        put_on_lane(scenes, b, 0, COMMANDED, own, 30.0, 30.0)
        for k in range(3):
            s = 70.0 + 40.0 * k + 10.0 * normal(state, 0.0, 1.0)
            speed = 24.0 + 2.0 * normal(state, 0.0, 1.0)
            put_on_lane(scenes, b, 1 + k, IDM, own, s, speed)
        for k in range(2):
            s = 200.0 + 100.0 * k + 10.0 * normal(state, 0.0, 1.0)
            speed = 20.0 + 5.0 * normal(state, 0.0, 1.0)
            put_on_lane(scenes, b, 4 + k, IDM, oncoming, s, speed)
            scenes.vehicles[b, 4 + k].target_lane = oncoming
        for i in range(1, 6):
            scenes.vehicles[b, i].changes_lanes = False


@compiled_of_scenes
def _judge(scenes: Scenes, rows: Ints, weights: Floats, out: Floats) -> None:
    """[`TwoWayEnv._reward`, `TwoWayEnv._rewards`] Where that divides by 0, it is no number."""
    for b in rows:
        ego, lanes = scenes.vehicles[b, 0], scenes.road.lanes
        last = lanes[ego.lane].lanes - 1
        number = ego.target_lane - lanes[ego.target_lane].first
        out[b, 1] = ego.speed_index / (scenes.target_speeds.size - 1)
        out[b, 2] = (last - number) / last
        out[b, 0] = weighted(weights, out[b])
