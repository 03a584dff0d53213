"""highway-env's `highway` and `highway-fast`: a motorway of straight lanes."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from numpy.typing import NDArray

from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads.exit import append
from charms_bench.roads.layout import Edge, straight_lanes
from charms_bench.roads.scenes import COMMANDED, IDM, Scenes
from charms_bench.roads.task import (
    Reward,
    Task,
    draw_behaviour,
    end_off_road,
    is_on_own_lane,
    reward_of,
    speed_term,
    wanted_lane,
)

EGO_SPEED_MPS = 25.0
SPEED_LOW, SPEED_HIGH = 0.7, 0.8
"""The speeds at which the other vehicles start, as fractions of the speed limit."""


class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices, and other units are SI."""

    egos: int
    vehicles: int
    """With the egos."""
    lanes: int
    ego_lane: int
    """The ego's lane at the start, -1 if it is drawn."""
    ego_spacing: float
    spacing: float
    crowding: float
    """highway-env's factor for all distances; it falls with the number of lanes."""
    others_collide: bool
    """Whether collisions between vehicles other than the ego are noticed."""


class Highway(Task):
    """[`HighwayEnv`]"""

    terms = ("collision_reward", "right_lane_reward", "high_speed_reward", "on_road_reward")
    can_have_egos = True
    others_collide = True
    has_goal = False

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        lanes, ego_lane = int(config["lanes_count"]), config["initial_lane_id"]
        self.vehicles = self.egos + int(config["vehicles_count"])
        self._ends_off_road = bool(config["offroad_terminal"])
        self._rule = Rule(
            self.egos,
            self.vehicles,
            lanes,
            -1 if ego_lane is None else range(lanes)[ego_lane],
            float(config["ego_spacing"]),
            1 / config["vehicles_density"],
            maths.exp(-5 / 40 * lanes),
            self.others_collide,
        )

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`HighwayEnv._create_road`]"""
        return straight_lanes("0", "1", config["lanes_count"], 0.0, 10_000.0)

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        _judge(scenes, rows, self.reward, self._rule.lanes, rewards)

    def is_terminated(self, scenes: Scenes) -> Bools:
        is_over = super().is_terminated(scenes)
        if self._ends_off_road:
            end_off_road(scenes, is_over)
        return is_over


class FastHighway(Highway):
    """[`HighwayEnvFast`]"""

    others_collide = False


@compiled_of_scenes
def _start(scenes: Scenes, rows: Ints, rule: Rule) -> None:
    """[`HighwayEnv._create_vehicles`, `HighwayEnvFast._create_vehicles`]"""
    for b in rows:
        state = scenes.generator[b]
        count, i = 0, rule.egos
        for ego in range(rule.egos):
            lane = rule.ego_lane if rule.ego_lane >= 0 else integers(state, 0, rule.lanes)
            at = (count, ego, COMMANDED, lane)
            append(scenes, b, at, EGO_SPEED_MPS, rule.ego_spacing, rule.crowding)
            count += 1
            # The others are split among the egos as evenly as possible, the first have more.
            for _ in range((rule.vehicles - 1 - ego) // rule.egos):
                lane = integers(state, 0, rule.lanes)
                limit = scenes.road.lanes[lane].speed_limit
                speed = uniform(state, SPEED_LOW * limit, SPEED_HIGH * limit)
                append(scenes, b, (count, i, IDM, lane), speed, rule.spacing, rule.crowding)
                draw_behaviour(scenes, b, i)
                scenes.vehicles[b, i].checks_collisions = rule.others_collide
                count, i = count + 1, i + 1


@compiled_of_scenes
def _judge(scenes: Scenes, rows: Ints, reward: Reward, lanes: int, out: Floats) -> None:
    """[`HighwayEnv._reward`, `HighwayEnv._rewards`]"""
    low, high = reward.weights[0], reward.weights[2] + reward.weights[1]
    for b in rows:
        ego = scenes.vehicles[b, 0]
        out[b, 1] = ego.crashed
        out[b, 2] = wanted_lane(ego) / max(lanes - 1, 1)
        out[b, 3] = speed_term(reward, ego.speed * ego.direction_x)
        out[b, 4] = is_on_own_lane(scenes, b)
        out[b, 0] = reward_of(reward, out[b], low, high) * out[b, 4]
