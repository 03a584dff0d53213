"""What is particular to one of highway-env's environments: its scenes, rewards and endings."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes, inlined
from charms_bench.foundation.generator import random, uniform
from charms_bench.roads.fault import ranks_of
from charms_bench.roads.layout import Edge, Layout, RoadObject
from charms_bench.roads.scenes import COMMANDED, GAINS, NOTHING, Row, Scenes
from charms_bench.world.recorded_moments import Moments
from charms_bench.world.road import is_on_lane
from charms_bench.world.scene import Vehicles

ACTIONS = ("DiscreteMetaAction", "ContinuousAction", "DiscreteAction")


class Reward(NamedTuple):
    """What highway-env's configuration says of a reward."""

    weights: Floats
    """(K,) what the terms are multiplied by."""
    speed_low: float
    """The speed whose term is 0, m/s."""
    speed_high: float
    """The speed whose term is 1, m/s."""
    normalises: bool


class Task(ABC):
    """The road and the rules of an environment; methods take the scenes `rows` (R,)."""

    terms: ClassVar[tuple[str, ...]]
    """The terms of the reward, in highway-env's order, which the configuration weights by name."""
    actions: ClassVar[tuple[str, ...]] = ACTIONS
    """The types of actions with which highway-env's rewards can be computed."""
    has_info: ClassVar[bool] = True
    """Whether highway-env says anything about a step."""
    observes_before: ClassVar[bool] = False
    """Whether highway-env observes when the action is given, before the vehicles move."""
    idm: ClassVar[Mapping[str, float]] = {}
    """The constants of `IdmMobilParameters` that are particular to the environment."""
    regulation_steps = 0
    """After so many simulation steps, vehicles look who has the right of way; 0 if never."""
    links: Sequence[Sequence[int]] | None = None
    """The lanes that follow each lane (L), along which vehicles look ahead. If None, they do not,
    and all roads follow each other that meet at a node."""
    takes_types = True
    """Whether the vehicles other than the egos are of the type `other_vehicles_type`."""
    has_goal = True
    """Whether the ego should get somewhere; see `has_reached_goal`."""
    comes_and_goes = False
    """Whether vehicles enter and leave after each decision of highway-env; see `follow`."""
    can_have_egos = False
    """Whether several vehicles can be controlled."""
    rewards_each = False
    """Whether highway-env has a reward and an ending of each of them."""
    vehicles: int
    """The most vehicles of a scene, with the egos."""
    numbers: Ints | None = None
    """(B,) those at which the next episodes start; by default, all start at the first."""
    moments: Moments | None = None
    """The moments of a recorded scene at which episodes start; None if vehicles are placed."""
    objects: Sequence[RoadObject] = ()
    """What stands on the road, in highway-env's order [`Road.objects`]."""

    def __init__(self, config: Mapping[str, Any]) -> None:
        weights = np.array([float(config.get(term, 0)) for term in self.terms])
        low, high, *_ = config.get("reward_speed_range", (0, 0))
        normalises = bool(config.get("normalize_reward"))
        self.reward = Reward(weights, float(low), float(high), normalises)
        self.egos = int(config.get("controlled_vehicles", 1))
        """The number of controlled vehicles."""
        self.duration = float(config.get("duration", np.inf))
        """The time after which an episode is truncated, s."""
        self.layout = Layout(self.lanes_of(config))
        self.lanes = self.layout.lanes
        """The indices of lanes by highway-env's names: two nodes and a number."""

    @abstractmethod
    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """The lanes of its road, in the order of highway-env's calls of `RoadNetwork.add_lane`."""

    @abstractmethod
    def start(self, scenes: Scenes, rows: Ints) -> None:
        """Places the vehicles of new episodes by the scenes' random generators."""

    def enter(self, scenes: Scenes, vehicles: Vehicles, numbers: Ints) -> None:
        """Completes M recorded vehicles that appear after the start of moments `numbers` (M,)."""
        raise NotImplementedError

    def prepare(self, scenes: Scenes, rows: Ints) -> None:  # noqa: B027  # most do nothing
        """Does what comes before the actions of a decision."""

    @abstractmethod
    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        """Writes the rewards after actions (B, ...), and their terms, into `rewards` (B, 1 + K)."""

    def follow(self, scenes: Scenes, rows: Ints) -> None:  # noqa: B027  # most tasks do nothing
        """Changes the scenes `rows` after a decision and its observation."""

    def is_terminated(self, scenes: Scenes) -> Bools:
        """Whether each scene (B,) is over; by default, whether the ego has crashed."""
        return np.array(scenes.vehicles["crashed"][:, 0])

    def is_truncated(self, scenes: Scenes) -> Bools:
        """Whether the time of each scene (B,) is over."""
        return np.greater_equal(scenes.time, self.duration)

    def navigate(self, scenes: Scenes, rows: Ints) -> None:
        """Gives the egos of new episodes a route to the goal; by default, they keep their own."""
        return

    def has_reached_goal(self, scenes: Scenes, lanes_before: Ints) -> Bools:
        """Whether each ego (B,) is where it should go; by default, on the last road of its route.

        highway-env rewards some of these goals; it does not end an episode there. `lanes_before`
        (B,) are the lanes from which the egos came to their roads; -1 for none.
        """
        ego = scenes.vehicles[:, 0]
        each, last = np.arange(ego.size), ego["route_end"] - 1
        road = scenes.road.lanes["first"][ego["lane"]]
        return np.asarray((last >= 0) & (ego["route_roads"][each, last] == road))

    @property
    def starts(self) -> Ints:
        """The lanes that begin where no other road ends, at which vehicles can flow in."""
        road = self.layout.network
        return np.nonzero(~np.isin(road.lanes["first"], road.successors))[0]

    def open_ends(self) -> None:  # noqa: B027  # on most roads, they do not come back
        """Has vehicles that leave not come back, for a road with an inflow."""

    def send(self, scenes: Scenes, b: int, i: int) -> None:  # noqa: B027  # most do nothing
        """Gives vehicle i of scene b, which has flowed in, its route."""

    def head_for(self, scenes: Scenes, rows: Ints, i: int, destination: str) -> None:
        """Gives vehicle i of the scenes `rows` (R,) a route to a node."""
        head_for(scenes, rows, i, self.layout.routes_to([destination]))

    def entering(self, scenes: Scenes) -> Ints:
        """The vehicle (B,) that will enter a road on which others have the right of way.

        -1 stands for none, as by default.
        """
        return np.full(len(scenes.vehicles), -1)

    def main_lanes(self, scenes: Scenes) -> Bools:
        """Whether, for the entering vehicle, others have the right of way on each lane (L,)."""
        return np.zeros(scenes.road.lanes.size, dtype=np.bool_)

    def ranks(self, scenes: Scenes) -> Ints:
        """Which lanes (L,) have the right of way over which others; see `fault.Fault`."""
        return ranks_of(scenes.road, self.main_lanes(scenes))

    def information(self, scenes: Scenes) -> dict[str, Any]:
        """What the info has in addition, (B,) or (B, A) by name."""
        return {}


@compiled
def plan_route(scenes: Scenes, b: int, i: int, routes: Ints, destination: int) -> None:
    """Gives vehicle i its route, one of those of `Layout.routes_to`."""
    vehicle, route = scenes.vehicles[b, i], routes[destination, scenes.vehicles[b, i].lane]
    first = scenes.road.lanes[vehicle.lane].first
    vehicle.route_step, vehicle.route_end = 0, 1 + route[0]
    vehicle.route_roads[0], vehicle.route_numbers[0] = first, vehicle.lane - first
    for k in range(1, 1 + route[0]):
        vehicle.route_roads[k], vehicle.route_numbers[k] = route[k], -1


@compiled_of_scenes
def head_for(scenes: Scenes, rows: Ints, i: int, routes: Ints) -> None:
    """See `Task.head_for`."""
    for b in rows:
        plan_route(scenes, b, i, routes, 0)


@compiled
def draw_behaviour(scenes: Scenes, b: int, i: int) -> None:
    """Draws the gains of vehicle i, if it is linear, and its exponent [`randomize_behavior`]."""
    c = scenes.constants[0]
    if c.is_linear:
        for k in range(GAINS):
            drawn = random(scenes.generator[b])
            scenes.vehicles[b, i].gains[k] = scenes.gains[1, k] + drawn * scenes.gains[2, k]
    low, high = c.exponent_low, c.exponent_high
    scenes.vehicles[b, i].exponent = uniform(scenes.generator[b], low, high)


@compiled
def has_space(scenes: Scenes, b: int, count: int, x: float, y: float, space: float) -> bool:
    """Whether none of the first vehicles is closer to a point than a distance."""
    for i in range(count):
        vehicle = scenes.vehicles[b, i]
        dx, dy = vehicle.x - x, vehicle.y - y
        if vehicle.kind != NOTHING and math.sqrt(dx * dx + dy * dy) < space:
            return False
    return True


@compiled
def weighted(weights: Floats, row: Floats) -> float:
    """The sum of the terms that follow the reward in its row, times their weights."""
    total = 0.0
    for k in range(weights.size):
        total += weights[k] * row[k + 1]
    return total


@inlined
def reward_of(reward: Reward, row: Floats, low: float, high: float) -> float:
    """The same, from 0 at a value to 1 at another one if the reward is normalised."""
    total = weighted(reward.weights, row)
    return to_unit_interval(total, low, high) if reward.normalises else total


@inlined
def speed_term(reward: Reward, speed: float) -> float:
    """The term of a speed, from 0 to 1."""
    return clip(to_unit_interval(speed, reward.speed_low, reward.speed_high), 0.0, 1.0)


@compiled
def to_unit_interval(value: float, low: float, high: float) -> float:
    """A value, scaled from [low, high] to [0, 1] [`utils.lmap`]."""
    return (value - low) / (high - low)


@compiled
def wanted_lane(ego: Row) -> int:
    """The lane to which a commanded ego steers, or the one on which an ego with controls is."""
    return int(ego.target_lane if ego.kind == COMMANDED else ego.lane)


@compiled
def is_on_own_lane(scenes: Scenes, b: int, i: int = 0) -> bool:
    """Whether a vehicle's centre is on its nearest lane [`RoadObject.on_road`]."""
    vehicle = scenes.vehicles[b, i]
    return bool(is_on_lane(scenes.road, vehicle.lane, vehicle.x, vehicle.y, 0.0))


@compiled_of_scenes
def end_off_road(scenes: Scenes, is_over: Bools) -> None:
    """Ends the scenes (B,) whose ego has left the road."""
    for b in range(is_over.size):
        is_over[b] |= not is_on_own_lane(scenes, b)
