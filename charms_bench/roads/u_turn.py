"""highway-env's `u-turn`: overtaking slow vehicles in a tight bend."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.foundation.generator import normal
from charms_bench.roads.layout import WIDTH_M, Edge
from charms_bench.roads.scenes import COMMANDED, IDM, Scenes, put_on_lane
from charms_bench.roads.task import (
    Reward,
    Task,
    draw_behaviour,
    head_for,
    is_on_own_lane,
    plan_route,
    reward_of,
    speed_term,
)
from charms_bench.world.road_network import (
    NO_LINE,
    SOLID,
    SOLID_LINE,
    STRIPED,
    CircularLane,
    StraightLane,
)

LENGTH_M, RADIUS_M = 128.0, 20.0
"""Of the straight lanes, and of the inner lane of the bend."""
_VEHICLES = (
    ("a", "b", 0, 25.0, 13.5),
    ("a", "b", 1, 56.0, 14.5),
    ("b", "c", 1, 0.5, 4.5),
    ("b", "c", 0, 17.5, 5.5),
    ("c", "d", 0, 1.0, 3.5),
    ("c", "d", 1, 30.0, 5.5),
)
"""The lanes of the other vehicles, their mean positions along them, m, and speeds, m/s."""
DEVIATION = 2.0
"""Of positions, m, and of speeds, m/s."""


class UTurn(Task):
    """[`UTurnEnv`]"""

    terms = ("collision_reward", "left_lane_reward", "high_speed_reward", "on_road_reward")
    vehicles = 7

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        self._routes = self.layout.routes_to(["d"])
        self._lanes = np.array([self.lanes["a", "b", 0], *(self.lanes[k[:3]] for k in _VEHICLES)])
        self._means = np.array([each[3:] for each in _VEHICLES])

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`UTurnEnv._make_road`]"""
        inner, outer = (SOLID_LINE, STRIPED), (NO_LINE, SOLID_LINE)
        for y, lines in ((WIDTH_M, inner), (0.0, outer)):
            yield "c", "d", StraightLane(start=(LENGTH_M, y), end=(0.0, y), line_types=lines)
        for k, lines in enumerate(((SOLID, STRIPED), (NO_LINE, SOLID))):
            bend = CircularLane(
                center=(LENGTH_M, WIDTH_M + RADIUS_M),
                radius=RADIUS_M + k * WIDTH_M,
                start_phase=math.radians(90),
                end_phase=math.radians(-90),
                clockwise=False,
                line_types=lines,
            )
            yield "b", "c", bend
        for k, lines in ((1, inner), (2, outer)):
            y = 2 * RADIUS_M + k * WIDTH_M
            yield "a", "b", StraightLane(start=(0.0, y), end=(LENGTH_M, y), line_types=lines)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._lanes, self._means, self._routes)

    def send(self, scenes: Scenes, b: int, i: int) -> None:
        head_for(scenes, np.array([b]), i, self._routes)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, self.reward, rewards)


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, lanes: Ints, means: Floats, routes: Ints) -> None:
    """[`UTurnEnv._make_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        put_on_lane(scenes, b, 0, COMMANDED, lanes[0], 0.0, 16.0)
        plan_route(scenes, b, 0, routes, 0)
        for i in range(1, lanes.size):
            s = means[i - 1, 0] + normal(state, 0.0, 1.0) * DEVIATION
            speed = means[i - 1, 1] + normal(state, 0.0, 1.0) * DEVIATION
            put_on_lane(scenes, b, i, IDM, lanes[i], s, speed)
            plan_route(scenes, b, i, routes, 0)
            if i == 1:
                draw_behaviour(scenes, b, i)


@compiled_of_scenes
def _judge(scenes: Scenes, rows: Ints, reward: Reward, out: Floats) -> None:
    """[`UTurnEnv._reward`, `UTurnEnv._rewards`]"""
    low, high = reward.weights[0], reward.weights[2] + reward.weights[1]
    for b in rows:
        ego = scenes.vehicles[b, 0]
        row = scenes.road.lanes[ego.lane]
        out[b, 1] = ego.crashed
        out[b, 2] = (ego.lane - row.first) / max(row.lanes - 1, 1)
        out[b, 3] = speed_term(reward, ego.speed)
        out[b, 4] = is_on_own_lane(scenes, b)
        out[b, 0] = reward_of(reward, out[b], low, high) * out[b, 4]
