"""highway-env's `merge` and `merge-generic`: a motorway with a ramp that ends."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads.layout import WIDTH_M, Edge, RoadObject, straight_lanes
from charms_bench.roads.scenes import (
    COMMANDED,
    CONTINUOUS,
    IDM,
    NOTHING,
    OBSTACLE,
    Scenes,
    put_on_lane,
)
from charms_bench.roads.task import Reward, Task, to_unit_interval, weighted
from charms_bench.world.actions import LANE_LEFT, LANE_RIGHT
from charms_bench.world.road_network import NO_LINE, SOLID_LINE, STRIPED, SineLane, StraightLane

SECTIONS = ("before", "converge", "parallel", "after")
LENGTHS_M = (150.0, 80.0, 80.0, 150.0)
"""Those of the sections of `merge`."""
AMPLITUDE_M = 3.25
"""Half of how far the ramp comes nearer."""
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
    spawned_until: float
    """Where `merge-generic` places the last vehicle."""


class Merge(Task):
    """[`MergeEnv`]"""

    actions = ("DiscreteMetaAction", "DiscreteAction")
    terms = (
        "collision_reward",
        "right_lane_reward",
        "high_speed_reward",
        "lane_change_reward",
        "merging_speed_reward",
    )
    vehicles = 5

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        lanes, lengths = self.lanes, self.lengths_of(config)
        main_lanes, ramp_end = self.layout.graph["a"]["b"], float(sum(lengths[:3]))
        self.objects = [RoadObject(ramp_end, WIDTH_M * main_lanes)]
        self._end_x = float(sum(lengths) - 90)
        self._rule = Rule(
            lanes["a", "b", 0],
            main_lanes,
            lanes["j", "k", 0],
            lanes.get(("b", "c", 2), -1),
            ramp_end,
        )

    def lengths_of(self, config: Mapping[str, Any]) -> Sequence[float]:
        """The lengths of the sections, m."""
        return LENGTHS_M

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`MergeEnv._make_road`]"""
        b, c, d = (sum(LENGTHS_M[:k]) for k in (2, 3, 4))
        for y, left, right in ((0.0, SOLID_LINE, STRIPED), (WIDTH_M, NO_LINE, SOLID_LINE)):
            yield "a", "b", StraightLane(start=(0.0, y), end=(b, y), line_types=(left, right))
            yield "b", "c", StraightLane(start=(b, y), end=(c, y), line_types=(left, STRIPED))
            yield "c", "d", StraightLane(start=(c, y), end=(d, y), line_types=(left, right))
        yield from ramp(LENGTHS_M, 2 * WIDTH_M, NO_LINE, 20.0)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, actions, self.reward, self._rule.judged, rewards)

    def is_terminated(self, scenes: Scenes) -> Bools:
        return np.asarray(scenes.vehicles["crashed"][:, 0] | self._has_passed(scenes))

    def has_reached_goal(self, scenes: Scenes, lanes_before: Ints) -> Bools:
        return self._has_passed(scenes)

    def _has_passed(self, scenes: Scenes) -> Bools:
        """Whether each ego (B,) has passed the place where the lanes merge."""
        return np.asarray(scenes.vehicles["x"][:, 0] > self._end_x)

    def entering(self, scenes: Scenes) -> Ints:
        """The vehicle (B,) on the ramp, at the start of an episode."""
        kind, lane = scenes.vehicles["kind"], scenes.vehicles["lane"]
        is_on_ramp = (kind > OBSTACLE) & (lane == self._rule.ramp)
        return np.where(is_on_ramp.any(axis=1), np.argmax(is_on_ramp, axis=1), -1)

    def main_lanes(self, scenes: Scenes) -> Bools:
        """Those of the motorway; highway-env forbids others to change to the ramp."""
        return np.asarray(scenes.road.lanes["forbidden"] == 0)


class GenericMerge(Merge):
    """[`MergeGenericEnv`]"""

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        self.vehicles = 2 + int(config["vehicles_count"])

    def lengths_of(self, config: Mapping[str, Any]) -> Sequence[float]:
        for name in SECTIONS[:3]:
            if not (length := config[f"{name}_merge_length"]) > 0:
                raise InputError(f"config.{name}_merge_length: {length!r}; expected more than 0")
        return [config[f"{name}_merge_length"] for name in SECTIONS]

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`MergeGenericEnv._make_road`]"""
        count, lengths = config["lanes_count"], self.lengths_of(config)
        first, second = lengths[0] + lengths[1], sum(lengths[:3])
        yield from straight_lanes("a", "b", count, 0.0, first)
        yield from straight_lanes("b", "c", count, first, lengths[2])
        yield from straight_lanes("c", "d", count, second, lengths[3])
        yield from ramp(lengths, WIDTH_M * count, STRIPED, 30.0)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start_generic(scenes, rows, self.vehicles, self._rule)


def ramp(lengths: Sequence[float], y: float, left: int, speed_limit: float) -> Iterator[Edge]:
    """The lanes of a ramp that ends beside the motorway, at y, with that line on its left."""
    before, converge, parallel, _ = lengths
    first, far = before + converge, y + 2 * AMPLITUDE_M
    lines = SOLID_LINE, SOLID_LINE
    common: dict[str, Any] = {"forbidden": True, "speed_limit": speed_limit}
    yield "j", "k", StraightLane(start=(0.0, far), end=(before, far), line_types=lines, **common)
    bend = SineLane(
        start=(before, y + AMPLITUDE_M),
        end=(first, y + AMPLITUDE_M),
        amplitude=AMPLITUDE_M,
        pulsation=2 * math.pi / (2 * converge),
        phase=math.pi / 2,
        line_types=lines,
        **common,
    )
    yield "k", "b", bend
    end, lines = (first + parallel, y), (left, SOLID_LINE)
    yield "b", "c", StraightLane(start=(first, y), end=end, line_types=lines, **common)


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule) -> None:
    """[`MergeEnv._make_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        put_on_lane(scenes, b, 0, COMMANDED, rule.main + 1, 30.0, 30.0)
        for i, (s, speed) in enumerate(((90.0, 29.0), (70.0, 31.0), (5.0, 31.5))):
            lane = rule.main + integers(state, 0, 2)
            s += uniform(state, -5.0, 5.0)
            speed += uniform(state, -1.0, 1.0)
            put_on_lane(scenes, b, i + 1, IDM, lane, s, speed)
        put_on_lane(scenes, b, 4, IDM, rule.ramp, 110.0, 20.0)
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
        put_on_lane(scenes, b, 0, COMMANDED, rule.main + lanes[0], along[0], 30.0)
        for _ in range(vehicles - 2):
            for _ in range(TRIES):
                lane = integers(state, 0, rule.main_lanes)
                s = uniform(state, 0.0, rule.spawned_until)
                is_free = True
                for k in range(count):
                    is_free &= lanes[k] != lane or abs(s - along[k]) > SAFE_DISTANCE_M
                if is_free:
                    speed = 30.0 + uniform(state, -2.0, 2.0)
                    put_on_lane(scenes, b, count, IDM, rule.main + lane, s, speed)
                    lanes[count], along[count] = lane, s
                    count += 1
                    break
        put_on_lane(scenes, b, count, IDM, rule.ramp, 60.0, 20.0)
        scenes.vehicles[b, count].target_speed = 30.0


@compiled_of_scenes
def _judge(
    scenes: Scenes, rows: Ints, actions: Ints, reward: Reward, judged: int, out: Floats
) -> None:
    """[`MergeEnv._reward`, `MergeEnv._rewards`]"""
    weights = reward.weights
    for b in rows:
        ego = scenes.vehicles[b, 0]
        merging = 0.0
        for i in range(scenes.vehicles.shape[1]):
            vehicle = scenes.vehicles[b, i]
            if vehicle.lane == judged and vehicle.kind > CONTINUOUS:
                merging += (vehicle.target_speed - vehicle.speed) / vehicle.target_speed
        out[b, 1] = ego.crashed
        out[b, 2] = ego.lane - scenes.road.lanes[ego.lane].first
        out[b, 3] = to_unit_interval(ego.speed, reward.speed_low, reward.speed_high)
        out[b, 4] = actions[b] in (LANE_LEFT, LANE_RIGHT)
        out[b, 5] = merging
        total = weighted(weights, out[b])
        out[b, 0] = to_unit_interval(total, weights[0] + weights[4], weights[2] + weights[1])
