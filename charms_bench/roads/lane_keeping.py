"""highway-env's `lane-keeping`: staying on a winding lane with tyres that slip."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.roads.continuous_actions import kind_of_ego
from charms_bench.roads.layout import Edge
from charms_bench.roads.scenes import DYNAMICAL, Scenes, place
from charms_bench.roads.task import Task
from charms_bench.world.road import heading_at, is_on_lane, local_coordinates, position
from charms_bench.world.road_network import NO_LINE, STRIPED, SineLane, StraightLane

START_M = 50.0
"""Where on its lane the ego starts."""
ASIDE_M = -4.0
"""How far beside its centre."""
SPEED_MPS = 8.3


class LaneKeeping(Task):
    """[`LaneKeepingEnv`] The lane to keep is the ego's `target_lane`."""

    terms = ()
    actions = ("ContinuousAction", "DiscreteAction")
    has_info = False
    observes_before = True
    vehicles = 1

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        if kind_of_ego(config) != DYNAMICAL:
            raise InputError("config.action.dynamical: False is not supported, as in highway-env")
        self._first, self._second = self.lanes["c", "d", 0], self.lanes["a", "b", 0]

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`LaneKeepingEnv._make_road`]"""
        winding = SineLane(
            start=(0.0, 0.0),
            end=(500.0, 0.0),
            amplitude=5.0,
            pulsation=2 * math.pi / 100,
            phase=0.0,
            width=10.0,
        )
        yield "a", "b", winding
        yield "c", "d", StraightLane(start=(50.0, 50.0), end=(115.0, 15.0), width=10.0)
        end, lines = (115.0 + 20, 15.0 + 20 * (15.0 - 50) / (115 - 50)), (NO_LINE, STRIPED)
        yield "d", "a", StraightLane(start=(115.0, 15.0), end=end, width=10.0, line_types=lines)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._first)

    def prepare(self, scenes: Scenes, rows: Ints) -> None:
        _prepare(scenes, rows, self._second)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, rewards)

    def is_terminated(self, scenes: Scenes) -> Bools:
        return np.zeros(len(scenes.vehicles), dtype=np.bool_)


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, lane: int) -> None:
    """[`LaneKeepingEnv._make_vehicles`]"""
    for b in rows:
        x, y = position(scenes.road, lane, START_M, ASIDE_M)
        place(scenes, b, 0, DYNAMICAL, x, y, heading_at(scenes.road, lane, 0.0), SPEED_MPS)
        scenes.vehicles[b, 0].target_lane = lane


@compiled_of_scenes
def _prepare(scenes: Scenes, rows: Ints, following: int) -> None:
    """The part of `LaneKeepingEnv.step` that goes on to the following lane."""
    for b in rows:
        ego = scenes.vehicles[b, 0]
        if not is_on_lane(scenes.road, ego.target_lane, ego.x, ego.y, 0.0):
            ego.target_lane = following


@compiled_of_scenes
def _judge(scenes: Scenes, rows: Ints, out: Floats) -> None:
    """[`LaneKeepingEnv._reward`]"""
    for b in rows:
        ego = scenes.vehicles[b, 0]
        _, beside = local_coordinates(scenes.road, ego.target_lane, ego.x, ego.y)
        part = beside / scenes.road.lanes[ego.target_lane].width
        out[b, 0] = 1 - part * part
