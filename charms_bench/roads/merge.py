"""highway-env's `merge` and `merge-generic`: a motorway with a ramp that ends."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads.scenes import (
    COMMANDED,
    CONTINUOUS,
    IDM,
    NOTHING,
    OBSTACLE,
    Scenes,
    put_on_lane,
)
from charms_bench.roads.task import Task, share, weighted
from charms_bench.world.actions import LANE_LEFT, LANE_RIGHT

SAFE_DISTANCE_M = 15.0
"""The least distance between vehicles at the start of `merge-generic`."""
TRIES = 10
"""How often `merge-generic` tries to place a vehicle."""


class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices, and other units are SI."""

    main: int
    """The left lane of the motorway before the ramp."""
    main_lanes: int
    ramp: int
    """The lane from which a vehicle merges."""
    judged: int
    """The lane whose vehicles should not be slow, -1 for none."""
    speed_low: float
    speed_high: float
    spawned_until: float
    """Where `merge-generic` places the last vehicle."""


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

    def __init__(self, config: Mapping[str, Any], network: Any) -> None:
        super().__init__(config, network)
        lanes, sections = self.lanes, ("before", "converge", "parallel", "after")
        lengths = [config.get(f"{name}_merge_length", 0) for name in sections]
        self._end_x = float(sum(lengths) - 90) if any(lengths) else 370.0
        self._rule = Rule(
            lanes["a", "b", 0],
            len(network.graph["a"]["b"]),
            lanes["j", "k", 0],
            lanes.get(("b", "c", 2), -1),
            float(config["reward_speed_range"][0]),
            float(config["reward_speed_range"][1]),
            float(sum(lengths[:3])),
        )

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, actions, self.weights, self._rule, rewards)

    def is_terminated(self, scenes: Scenes) -> Bools:
        return np.asarray(scenes.vehicles["crashed"][:, 0] | self.has_reached_goal(scenes))

    def has_reached_goal(self, scenes: Scenes) -> Bools:
        """Whether each ego (B,) has passed the place where the lanes merge."""
        return np.asarray(scenes.vehicles["x"][:, 0] > self._end_x)

    def entering(self, scenes: Scenes) -> Ints:
        """The vehicle (B,) on the ramp, at the start of an episode."""
        kind, lane = scenes.vehicles["kind"], scenes.vehicles["lane"]
        return np.asarray(np.argmax((kind > OBSTACLE) & (lane == self._rule.ramp), axis=1))

    def main_lanes(self, scenes: Scenes) -> Bools:
        """Those of the motorway; highway-env forbids others to change to the ramp."""
        return np.asarray(scenes.road.lanes["forbidden"] == 0)


class GenericMerge(Merge):
    """[`MergeGenericEnv`]"""

    def __init__(self, config: Mapping[str, Any], network: Any) -> None:
        super().__init__(config, network)
        self.vehicles = 2 + int(config["vehicles_count"])

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start_generic(scenes, rows, self.vehicles, self._rule)


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule) -> None:
    """[`MergeEnv._make_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        put_on_lane(scenes, b, 0, COMMANDED, rule.main + 1, 30.0, 0.0, 30.0)
        for i, (s, speed) in enumerate(((90.0, 29.0), (70.0, 31.0), (5.0, 31.5))):
            lane = rule.main + integers(state, 0, 2)
            s += uniform(state, -5.0, 5.0)
            speed += uniform(state, -1.0, 1.0)
            put_on_lane(scenes, b, i + 1, IDM, lane, s, 0.0, speed)
        put_on_lane(scenes, b, 4, IDM, rule.ramp, 110.0, 0.0, 20.0)
        scenes.vehicles[b, 4].target_speed = 30.0


@compiled_of_scenes
def _start_generic(scenes: Scenes, rows: Ints, vehicles: int, rule: Rule) -> None:
    """[`MergeGenericEnv._make_vehicles`]"""
    lanes, along = np.empty(vehicles, dtype=np.int64), np.empty(vehicles)
    for b in rows:
        state = scenes.generator[b]
        for i in range(vehicles):
            scenes.vehicles[b, i].kind = NOTHING
        lanes[0], along[0], count = rule.main_lanes - 1, 30.0, 1
        put_on_lane(scenes, b, 0, COMMANDED, rule.main + lanes[0], along[0], 0.0, 30.0)
        for _ in range(vehicles - 2):
            for _ in range(TRIES):
                lane = integers(state, 0, rule.main_lanes)
                s = uniform(state, 0.0, rule.spawned_until)
                is_free = True
                for k in range(count):
                    is_free &= lanes[k] != lane or abs(s - along[k]) > SAFE_DISTANCE_M
                if is_free:
                    speed = 30.0 + uniform(state, -2.0, 2.0)
                    put_on_lane(scenes, b, count, IDM, rule.main + lane, s, 0.0, speed)
                    lanes[count], along[count] = lane, s
                    count += 1
                    break
        put_on_lane(scenes, b, count, IDM, rule.ramp, 60.0, 0.0, 20.0)
        scenes.vehicles[b, count].target_speed = 30.0


@compiled_of_scenes
def _judge(
    scenes: Scenes, rows: Ints, actions: Ints, weights: Floats, rule: Rule, out: Floats
) -> None:
    """[`MergeEnv._reward`, `MergeEnv._rewards`]"""
    for b in rows:
        ego = scenes.vehicles[b, 0]
        merging = 0.0
        for i in range(scenes.vehicles.shape[1]):
            vehicle = scenes.vehicles[b, i]
            if vehicle.lane == rule.judged and vehicle.kind > CONTINUOUS:
                merging += (vehicle.target_speed - vehicle.speed) / vehicle.target_speed
        out[b, 1] = ego.crashed
        out[b, 2] = ego.lane - scenes.road.lanes[ego.lane].first
        out[b, 3] = share(ego.speed, rule.speed_low, rule.speed_high)
        out[b, 4] = actions[b] in (LANE_LEFT, LANE_RIGHT)
        out[b, 5] = merging
        total = weighted(weights, out[b])
        out[b, 0] = share(total, weights[0] + weights[4], weights[2] + weights[1])
