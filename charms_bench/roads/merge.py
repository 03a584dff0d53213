"""highway-env's `merge-v0`: a motorway with a ramp that ends."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads.scenes import COMMANDED, CONTINUOUS, IDM, Scenes, put_on_lane
from charms_bench.roads.task import LaneName, Task
from charms_bench.world.actions import LANE_LEFT, LANE_RIGHT

END_M = 370.0
"""Where the episode is over [`MergeEnv._is_terminated`]."""
class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices."""

    main: int
    """The left lane of the motorway before the ramp."""
    ramp: int
    """The lane on which a vehicle merges."""
    beside: int
    """The lane beside the motorway at whose end the obstacle stands."""
    speed_low: float
    speed_high: float


class Merge(Task):
    """[`MergeEnv`]"""

    terms = (
        "collision_reward",
        "right_lane_reward",
        "high_speed_reward",
        "lane_change_reward",
        "merging_speed_reward",
    )
    vehicles = 5

    def __init__(self, config: Mapping[str, Any], lanes: Mapping[LaneName, int]) -> None:
        super().__init__(config, lanes)
        named = lanes["a", "b", 0], lanes["j", "k", 0], lanes["b", "c", 2]
        self._rule = Rule(*named, *map(float, config["reward_speed_range"]))

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule)

    def judge(self, scenes: Scenes, rows: Ints, actions: Ints, rewards: Floats) -> None:
        _judge(scenes, rows, actions, self.weights, self._rule, rewards)

    def is_terminated(self, scenes: Scenes) -> Bools:
        ego = scenes.vehicles[:, 0]
        return np.asarray(ego["crashed"] | (ego["x"] > END_M))


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule) -> None:
    """[`MergeEnv._make_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        put_on_lane(scenes, b, 0, COMMANDED, rule.main + 1, 30.0, 0.0, 30.0)
        for i, (s, speed) in enumerate(((90.0, 29.0), (70.0, 31.0), (5.0, 31.5))):
            lane = rule.main + integers(state, 0, 2)
            s += uniform(state, -5.0, 5.0)
            put_on_lane(scenes, b, i + 1, IDM, lane, s, 0.0, speed + uniform(state, -1.0, 1.0))
        put_on_lane(scenes, b, 4, IDM, rule.ramp, 110.0, 0.0, 20.0)
        scenes.vehicles[b, 4].target_speed = 30.0


@compiled_of_scenes
def _judge(
    scenes: Scenes, rows: Ints, actions: Ints, weights: Floats, rule: Rule, out: Floats
) -> None:
    """[`MergeEnv._reward`, `MergeEnv._rewards`]"""
    for b in rows:
        ego = scenes.vehicles[b, 0]
        number = ego.lane - scenes.road.lanes[ego.lane].first
        merging = 0.0
        for i in range(scenes.vehicles.shape[1]):
            vehicle = scenes.vehicles[b, i]
            if vehicle.lane == rule.beside and vehicle.kind > CONTINUOUS:
                merging += (vehicle.target_speed - vehicle.speed) / vehicle.target_speed
        out[b, 1] = ego.crashed
        out[b, 2] = number / 1
        out[b, 3] = (ego.speed - rule.speed_low) * 1 / (rule.speed_high - rule.speed_low)
        out[b, 4] = actions[b] in (LANE_LEFT, LANE_RIGHT)
        out[b, 5] = merging
        total = 0.0
        for k in range(weights.size):
            total += weights[k] * out[b, k + 1]
        low, high = weights[0] + weights[4], weights[2] + weights[1]
        out[b, 0] = (total - low) * 1 / (high - low)
