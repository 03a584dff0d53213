"""highway-env's `parking`: reaching a spot of a car park, between walls and parked vehicles."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads import goal_observation
from charms_bench.roads.layout import WIDTH_M, Edge, RoadObject
from charms_bench.roads.scenes import COMMANDED, CONTINUOUS, LANDMARK, Scenes, place, put_on_lane
from charms_bench.roads.task import Task
from charms_bench.world.road import heading_at, position
from charms_bench.world.road_network import SOLID, StraightLane

FEATURES = np.arange(1, len(goal_observation.FEATURES))
"""Those of the reward, all but `presence`, whatever is observed [`ParkingEnv.PARKING_OBS`]."""
SCALES = np.array([100.0, 100.0, 5.0, 5.0, 1.0, 1.0])
"""What they are divided by."""
SPOTS = 14
"""On each side."""
BESIDE_M, SPOT_M = 10.0, 8.0
"""How far beside the centre spots begin, and how long they are."""
WALLS_M = 70.0, 42.0
"""The lengths of the walls along x and along y."""
PARKED_AT_M = 4.0
"""How far along its spot a vehicle is parked."""


class Parking(Task):
    """[`ParkingEnv`]"""

    terms = ()

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        spots = len(self.lanes) - 2  # one is near the ego, and one is the goal
        self.vehicles = 1 + min(int(config["vehicles_count"]), spots)
        goal, (length, width) = RoadObject(0.0, 0.0, kind=LANDMARK), WALLS_M
        walls = [RoadObject(0.0, y, length=length, width=1.0) for y in (-width / 2, width / 2)]
        walls += [
            RoadObject(x, 0.0, math.pi / 2, length=width, width=1.0)
            for x in (-length / 2, length / 2)
        ]
        self.objects = [goal, *walls] if config["add_walls"] else [goal]
        self._collision = float(config["collision_reward"])
        self._success = float(config["success_goal_reward"])
        self._weights = np.array(config["reward_weights"], dtype=np.float64)
        if self._weights.size != FEATURES.size:
            raise InputError(f"config.reward_weights: expected {FEATURES.size} numbers")
        self._reached: Bools = np.zeros(0, dtype=np.bool_)

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`ParkingEnv._create_road`]"""
        lines, near, far = (SOLID, SOLID), BESIDE_M, BESIDE_M + SPOT_M
        for k in range(SPOTS):
            x = (k + 1 - SPOTS // 2) * WIDTH_M - WIDTH_M / 2
            yield "a", "b", StraightLane(start=(x, near), end=(x, far), line_types=lines)
            yield "b", "c", StraightLane(start=(x, -near), end=(x, -far), line_types=lines)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self.vehicles)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        seen = np.empty((2, rows.size, FEATURES.size))
        goal_observation.observe(scenes, rows, FEATURES, SCALES, seen)
        near = self.goal_rewards(*seen)
        self._reached = near > -self._success
        rewards[:, 0] = near + self._collision * scenes.vehicles["crashed"][:, 0]

    def goal_rewards(self, achieved: Floats, desired: Floats, exponent: float = 0.5) -> Floats:
        """The rewards (...) for observations (..., F) of goals [`ParkingEnv.compute_reward`].

        They are minus the weighted p-norm of the difference, to the power of p.
        """
        apart = np.abs(achieved - desired)
        total = np.zeros(apart.shape[:-1])
        for k, weight in enumerate(self._weights):
            total += apart[..., k] * weight
        return -_power(total.ravel(), exponent).reshape(total.shape)

    def is_terminated(self, scenes: Scenes) -> Bools:
        return super().is_terminated(scenes) | self._reached

    def information(self, scenes: Scenes) -> dict[str, Any]:
        return {"is_success": self._reached}


@compiled
def _power(values: Floats, exponent: float) -> Floats:
    powers = np.empty(values.size)
    for k in range(values.size):
        powers[k] = maths.power(values[k], exponent)
    return powers


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, vehicles: int) -> None:
    """[`ParkingEnv._create_vehicles`]"""
    road = scenes.road
    for b in rows:
        state = scenes.generator[b]
        heading = 2.0 * math.pi * uniform(state, 0.0, 1.0)
        place(scenes, b, 0, COMMANDED, 0.0, 0.0, heading, 0.0)
        spots = np.arange(road.lanes.size)
        spots = spots[spots != scenes.vehicles[b, 0].lane]
        lane = spots[integers(state, 0, spots.size)]
        x, y = position(road, lane, road.lanes[lane].length / 2, 0.0)
        place(scenes, b, vehicles, LANDMARK, x, y, heading_at(road, lane, 0.0), 0.0)
        spots = spots[spots != lane]
        for i in range(1, vehicles):
            lane = spots[integers(state, 0, spots.size)]
            put_on_lane(scenes, b, i, CONTINUOUS, lane, PARKED_AT_M, 0.0)
            spots = spots[spots != lane]
