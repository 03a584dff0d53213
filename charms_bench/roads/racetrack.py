"""highway-env's `racetrack`, `racetrack-large` and `racetrack-oval`: following a track."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, uniform
from charms_bench.roads.layout import Edge, RoadObject
from charms_bench.roads.scenes import COMMANDED, IDM, NOTHING, Scenes, put_on_lane
from charms_bench.roads.task import Task, has_space, is_on_own_lane, to_unit_interval
from charms_bench.world.lane_geometry import STRAIGHT, Pair
from charms_bench.world.road import local_coordinates, position
from charms_bench.world.road_network import NO_LINE, SOLID, STRIPED, CircularLane, StraightLane

WIDTH_M, SPEED_LIMIT_MPS = 5.0, 10.0
"""Of the lanes; `racetrack-large` takes its limit from the configuration."""
SAFE_DISTANCE_M = 20.0
"""A vehicle that would start closer to another is left out."""
Kinds = tuple[int, int]
Line = tuple[Pair, Pair]
_CS, _CN, _SC = (SOLID, STRIPED), (SOLID, NO_LINE), (STRIPED, SOLID)
_SS, _NC = (STRIPED, STRIPED), (NO_LINE, SOLID)
"""Kinds of the lines on the left and on the right of a lane."""


class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices, and other units are SI."""

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
    """[`RacetrackEnv`]"""

    terms = ("lane_centering_reward", "action_reward", "collision_reward", "on_road_reward")
    actions = ("ContinuousAction", "DiscreteAction")
    takes_types = False
    start_lanes = 2

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        self.vehicles = 1 + int(config["other_vehicles"])
        self._rule = Rule(
            self.lanes["a", "b", 0],
            self.start_lanes,
            self.lanes["b", "c", 0],
            int(config["other_vehicles"]),
            float(config["lane_centering_cost"]),
        )
        roads = [
            [self.lanes[start, end, 0] for end in ends] for start, ends in self.layout.graph.items()
        ]
        self._roads = np.array([road for each in roads for road in each])
        self._nodes = np.cumsum([0, *map(len, roads)])
        self._action_weight = config["action_reward"]
        self._ends_off_road = bool(config["terminate_off_road"])
        self._on_road: Bools = np.ones(0, dtype=np.bool_)

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`RacetrackEnv._make_road`]"""
        at_start, left, right = (_CS, _SC), (_CN, _SC), (_CS, _NC)
        yield from straight("ab", at_start, ((42, 0), (100, 0)), ((42, 5), (100, 5)))
        yield from arcs("bc", left, (100, -20), (20, 90, -1), (25, 90, -1))
        yield from straight("cd", left, ((120, -20), (120, -30)), ((125, -20), (125, -30)))
        yield from arcs("de", left, (105, -30), (15, 0, -181), (20, 0, -181))
        yield from arcs("ef", right, (70, -30), (20, 0, 136), (15, 0, 137))
        slant = ((55.7, -15.7), (35.7, -35.7)), ((59.3934, -19.2), (39.3934, -39.2))
        yield from straight("fg", left, *slant)
        yield from arcs("gh", left, (18.1, -18.1), (25, 315, 170), (30, 315, 165))
        yield from arcs("hi", left, (18.1, -18.1), (25, 170, 56), (30, 170, 58))
        yield from arcs("ia", right, (43.2, 23.4), (23.5, 240, 270), (18.5, 238, 268))

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule, self._nodes, self._roads)

    def has_reached_goal(self, scenes: Scenes, lanes_before: Ints) -> Bools:
        """Whether each ego (B,) has come round to the road on which it has started."""
        lanes = scenes.road.lanes
        road = lanes["first"][scenes.vehicles["lane"][:, 0]]
        return np.asarray((road == self._rule.own) & (lanes_before >= 0))

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        norms = np.linalg.norm(actions.reshape(len(actions), -1), axis=1)
        costs = (self._action_weight * norms).astype(np.float64)
        is_single = norms.dtype == np.float32
        rewards[:, 2] = norms
        _judge(scenes, rows, costs, is_single, self.reward.weights, self._rule, rewards)
        self._on_road = rewards[:, 4] > 0

    def is_terminated(self, scenes: Scenes) -> Bools:
        crashed = super().is_terminated(scenes)
        return crashed | ~self._on_road if self._ends_off_road else crashed


class LargeRacetrack(Racetrack):
    """[`RacetrackEnvLarge`]"""

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`RacetrackEnvLarge._make_road`]"""
        limit, lines = config["speed_limit"], (_CN, _SS, _NC)
        asides = 0.0, WIDTH_M, 2 * WIDTH_M
        ends: list[Line] = [((42, d), (200, d)) for d in asides]
        yield from straight("ab", (_CS, _SS, _NC), *ends, limit=limit)
        yield from arcs("bc", lines, (200, -20), *((20 + d, 90, -1) for d in asides), limit=limit)
        ends = [((220 + d, -20), (220 + d, -61)) for d in asides]
        yield from straight("cd", lines, *ends, limit=limit)
        yield from arcs("de", lines, (205, -60), *((15 + d, 0, -181) for d in asides), limit=limit)
        turns = (20, 0, 136), (15, 0, 137), (10, 0, 137)
        yield from arcs("ef", lines, (170, -60), *turns, limit=limit)
        one = (155.7, -45.7), (135.7 - 30, -65.7 - 30)
        other = (159.3934, -49.2), (139.3934 - 30, -69.2 - 30)
        third = [
            (x + 2 * (other_x - x), y + 2 * (other_y - y))
            for (x, y), (other_x, other_y) in zip(one, other, strict=True)
        ]
        yield from straight("fg", lines, one, other, (third[0], third[1]), limit=limit)
        centre, angle = (118.1 - 30, -48.1 - 30), math.radians(205)
        turns = (25, 317, 205 - 3), (30, 317, 205), (35, 317, 205)
        yield from arcs("gh", lines, centre, *turns, limit=limit)
        sine, cosine = maths.sin_cos(angle)
        end_sine, end_cosine = maths.sin_cos(math.radians(30))
        ends = [
            (
                (centre[0] + (25 + d) * cosine, centre[1] + (25 + d) * sine),
                (42 - (15 + d) * end_cosine, -15 - (15 + d) * end_sine),
            )
            for d in asides
        ]
        yield from straight("hi", lines, *ends, limit=limit)
        turns = (15, 210, 88), (20, 210, 90), (25, 212, 88)
        yield from arcs("ia", lines, (42, -15), *turns, limit=limit)


class OvalRacetrack(Racetrack):
    """[`RacetrackEnvOval`]"""

    def __init__(self, config: Mapping[str, Any]) -> None:
        for key in ("length", "no_lanes"):
            if not config[key] > 0:
                what = "highway-env draws it without a seed"
                raise InputError(f"config.{key}: {config[key]!r} is not supported: {what}")
        self.start_lanes = int(config["no_lanes"])
        super().__init__(config)
        blocks = []
        if config["block_lane"]:
            blocks += [(s, y) for s in (40, 43, 46, 49) for y in (3.75, 6.25)]
        if config["force_decision"]:
            blocks += [(90, y) for y in (-1.25, 1.25, 8.85, 11.25)]
        self.objects = [RoadObject(config["length"] - s, y) for s, y in blocks]

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`RacetrackEnvOval._make_road`]"""
        end, count = config["length"], config["no_lanes"]
        asides = [WIDTH_M * k for k in (0, *range(1, count - 1), count - 1)]
        inner = [(STRIPED, NO_LINE)] * (len(asides) - 2)
        lines, last = (_CN, *inner, _SC), (_CN, *[_SC] * (len(asides) - 1))
        ends: list[Line] = [((0, d), (end + 1, d)) for d in asides]
        yield from straight("ab", (_CS, *inner, _SC), *ends)
        yield from arcs("bc", lines, (end, -20), *((20 + d, 90, 0) for d in asides))
        ends = [((end + 20 + d, -20), (end + 20 + d, -50)) for d in asides]
        yield from straight("cd", lines, *ends)
        yield from arcs("de", lines, (end + 5, -50), *((15 + d, 0, -90) for d in asides))
        yield from straight("ef", lines, *(((end + 5, -(65 + d)), (-5, -(65 + d))) for d in asides))
        yield from arcs("fg", lines, (-5, -50), *((15 + d, -90, -180) for d in asides))
        yield from straight("gh", lines, *(((-20 - d, -50), (-20 - d, -20)) for d in asides))
        yield from arcs("ha", last, (0, -20), *((20 + d, 180, 90) for d in asides))


def straight(
    nodes: str, lines: Sequence[Kinds], *ends: Line, limit: float = SPEED_LIMIT_MPS
) -> Iterator[Edge]:
    """Straight lanes between two nodes, each from a point to another."""
    for (start, end), kinds in zip(ends, lines, strict=True):
        lane = StraightLane(
            start=start, end=end, width=WIDTH_M, line_types=kinds, speed_limit=limit
        )
        yield nodes[0], nodes[1], lane


def arcs(
    nodes: str,
    lines: Sequence[Kinds],
    centre: Pair,
    *turns: tuple[float, float, float],
    limit: float = SPEED_LIMIT_MPS,
) -> Iterator[Edge]:
    """Lanes about a centre between two nodes, each with a radius, from one angle to another."""
    for (radius, first, last), kinds in zip(turns, lines, strict=True):
        lane = CircularLane(
            center=centre,
            radius=radius,
            start_phase=math.radians(first),
            end_phase=math.radians(last),
            clockwise=last > first,
            width=WIDTH_M,
            line_types=kinds,
            speed_limit=limit,
        )
        yield nodes[0], nodes[1], lane


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
        put_on_lane(scenes, b, 0, COMMANDED, lane, s, road.lanes[lane].speed_limit)
        count = 1
        if rule.others > 0:
            lane, s = rule.ahead + number, uniform(state, 0.0, road.lanes[rule.ahead].length)
            speed = 6.0 + uniform(state, 0.0, 3.0)
            put_on_lane(scenes, b, 1, IDM, lane, s, speed)
            count = 2
            for _ in range(integers(state, 0, rule.others)):
                lane = draw_lane(scenes, b, nodes, roads)
                s = uniform(state, 0.0, road.lanes[lane].length)
                speed = 6.0 + uniform(state, 0.0, 3.0)
                x, y = position(road, lane, s, 0.0)
                if has_space(scenes, b, count, x, y, SAFE_DISTANCE_M):
                    put_on_lane(scenes, b, count, IDM, lane, s, speed)
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
        out[b, 0] = to_unit_interval(total, weights[2], 1.0) * out[b, 4]
