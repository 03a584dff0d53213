"""highway-env's `intersection`: crossing four roads while vehicles come and go."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.foundation.generator import integers, normal, random, two_integers
from charms_bench.roads.fault import NO_RANK
from charms_bench.roads.layout import WIDTH_M, Edge
from charms_bench.roads.locating import forget
from charms_bench.roads.regulated_road import FREQUENCY_HZ
from charms_bench.roads.scenes import COMMANDED, IDM, NOTHING, Scenes, here_of, put_on_lane, tidy
from charms_bench.roads.stepping import advance
from charms_bench.roads.task import (
    Reward,
    Task,
    draw_behaviour,
    end_off_road,
    has_space,
    is_on_own_lane,
    plan_route,
    speed_term,
    to_unit_interval,
    weighted,
)
from charms_bench.world.lane_geometry import Pair
from charms_bench.world.road import local_coordinates, position
from charms_bench.world.road_network import NO_LINE, SOLID, STRIPED, CircularLane, StraightLane

_SIDES = 4
RIGHT_RADIUS_M, ACCESS_M, SPEED_LIMIT_MPS = WIDTH_M + 5, 100.0, 10.0
"""The radius of a turn to the right, and the length of a road that leads to the intersection."""
MOST_TO_COME = 100
"""For so many vehicles there is room, in addition to those at the start."""
STARTS_ALONG_M = 80.0
"""Up to there, the vehicles at the start enter."""
CHANCE = 0.6
"""That of each to enter."""
SIMULATED_S = 3
"""For so long, they are simulated before the start of the episode."""
CHALLENGER_ALONG_M = EGO_ALONG_M = 60.0
SPEED_MPS = 8.0
"""The mean speed of vehicles that enter."""
SPACE_M, EGO_SPACE_M = 15.0, 20.0
"""The least distance to a vehicle that enters, and to an ego at the start."""
ARRIVED_M, LEAVING_M = 25.0, 20.0
"""An ego has arrived so far behind the intersection; the others leave so far before the end."""


class Rule(NamedTuple):
    """What the functions below need to know; lanes are indices, and other units are SI."""

    egos: int
    destination: int
    """The index of the egos' route, -1 if their sides are drawn."""
    chance: float
    """That of a vehicle to enter after a decision."""
    warm_up_steps: int


class Intersection(Task):
    """[`IntersectionEnv`]"""

    terms = ("collision_reward", "high_speed_reward", "arrived_reward", "on_road_reward")
    idm: ClassVar[Mapping[str, float]] = {
        "jam_distance_m": 7.0,
        "acceleration_mps2": 6.0,
        "deceleration_mps2": 3.0,
    }
    can_have_egos = rewards_each = True
    comes_and_goes = True

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        hz = config["simulation_frequency"]
        self.regulation_steps = int(1 / (1 / hz) / FREQUENCY_HZ)
        if not self.regulation_steps:
            raise InputError("config.simulation_frequency: expected at least 2 on this road")
        count = int(config["initial_vehicle_count"])
        to_come = min(math.ceil(self.duration * config["policy_frequency"]) + 1, MOST_TO_COME)
        self.vehicles = self.egos + max(count, 1) + to_come
        self._along = np.linspace(0, STARTS_ALONG_M, count)[:-1] if count > 1 else np.zeros(0)
        given = config["destination"]
        names = [f"o{side}" for side in range(_SIDES)]
        self._routes = self.layout.routes_to([*names, *([str(given)] if given else [])])
        self._entries = np.array([self.lanes[f"o{k}", f"ir{k}", 0] for k in range(_SIDES)])
        leads_out = ["il" in start and "o" in end for start, end, _ in self.lanes]
        self._exits = np.array(leads_out, dtype=np.bool_)
        self._ends_off_road = bool(config["offroad_terminal"])
        self._rule = Rule(
            self.egos,
            _SIDES if given else -1,
            float(config["spawn_probability"]),
            SIMULATED_S * int(hz),
        )
        self._rewards = np.zeros((0, self.egos))
        self._have_arrived = np.zeros((0, self.egos), dtype=np.bool_)

    def lanes_of(self, config: Mapping[str, Any]) -> Iterator[Edge]:
        """[`IntersectionEnv._make_road`]

        Between east and west, vehicles have the right of way over those between north and south,
        and straight on and to the right over those to the left.
        """
        left_radius, outer = RIGHT_RADIUS_M + WIDTH_M, RIGHT_RADIUS_M + WIDTH_M / 2
        aside, away = WIDTH_M / 2, ACCESS_M + outer
        for side in range(_SIDES):
            angle, priority = math.radians(90 * side), 3 if side % 2 else 1
            sine, cosine = maths.sin_cos(angle)

            def at(x: float, y: float, sine: float = sine, cosine: float = cosine) -> Pair:
                return cosine * x + -sine * y, sine * x + cosine * y

            into, left, ahead, right = f"ir{side}", *(f"il{(side + k) % 4}" for k in (1, 2, 3))
            common: dict[str, Any] = {"speed_limit": SPEED_LIMIT_MPS, "priority": priority}
            start, end, lines = at(aside, away), at(aside, outer), (STRIPED, SOLID)
            yield f"o{side}", into, StraightLane(start=start, end=end, line_types=lines, **common)
            turn = CircularLane(
                center=at(outer, outer),
                radius=RIGHT_RADIUS_M,
                start_phase=angle + math.radians(180),
                end_phase=angle + math.radians(270),
                line_types=(NO_LINE, SOLID),
                **common,
            )
            yield into, right, turn
            turn = CircularLane(
                center=at(-left_radius + aside, left_radius - aside),
                radius=left_radius,
                start_phase=angle,
                end_phase=angle + math.radians(-90),
                clockwise=False,
                line_types=(NO_LINE, NO_LINE),
                **{**common, "priority": priority - 1},
            )
            yield into, left, turn
            start, end, lines = at(aside, outer), at(aside, -outer), (STRIPED, NO_LINE)
            yield into, ahead, StraightLane(start=start, end=end, line_types=lines, **common)
            start, end, lines = at(outer, aside), at(away, aside), (NO_LINE, SOLID)
            out = StraightLane(start=start, end=end, line_types=lines, **common)
            yield right, f"o{right[-1]}", out

    def start(self, scenes: Scenes, rows: Ints) -> None:
        _start(scenes, rows, self._rule, self._along, self._entries, self._routes)

    def judge(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], rewards: Floats) -> None:
        self._rewards = np.zeros((len(scenes.vehicles), self.egos))
        self._have_arrived = np.zeros(self._rewards.shape, dtype=np.bool_)
        own = self._rewards, self._have_arrived
        _judge(scenes, rows, self.reward, self._exits, *own, rewards)

    def follow(self, scenes: Scenes, rows: Ints) -> None:
        _follow(scenes, rows, self._rule, self._entries, self._exits, self._routes)

    def ranks(self, scenes: Scenes) -> Ints:
        """highway-env's priorities; lanes that lead away say nothing."""
        return np.where(self._exits, NO_RANK, scenes.road.lanes["priority"])

    def has_reached_goal(self, scenes: Scenes, lanes_before: Ints) -> Bools:
        """Whether each ego (B,) has left the intersection [`IntersectionEnv.has_arrived`]."""
        return _have_arrived(scenes, self._exits)

    def is_terminated(self, scenes: Scenes) -> Bools:
        egos = scenes.vehicles[:, : self.egos]
        over = np.asarray(egos["crashed"].any(axis=1) | self._have_arrived.all(axis=1))
        if self._ends_off_road:
            end_off_road(scenes, over)
        return over

    def information(self, scenes: Scenes) -> dict[str, Any]:
        crashed = scenes.vehicles["crashed"][:, : self.egos]
        return {"agents_rewards": self._rewards, "agents_terminated": crashed | self._have_arrived}


@compiled
def enter(
    scenes: Scenes,
    b: int,
    entries: Ints,
    routes: Ints,
    along: float,
    chance: float,
    deviation: tuple[float, float],
    goes_straight: bool,
) -> None:
    """Has a vehicle enter by chance, if there is space [`IntersectionEnv._spawn_vehicle`].

    `deviation` is that of its position, m, and of its speed, m/s.
    """
    state = scenes.generator[b]
    if random(state) > chance:
        return
    side, destination = two_integers(state, _SIDES)
    if goes_straight:
        destination = (side + 2) % _SIDES
    lane, s = entries[side], along + 5.0 + normal(state, 0.0, 1.0) * deviation[0]
    speed = SPEED_MPS + normal(state, 0.0, 1.0) * deviation[1]
    x, y = position(scenes.road, lane, s, 0.0)
    if not has_space(scenes, b, scenes.vehicles.shape[1], x, y, SPACE_M):
        return
    k = 0
    while scenes.vehicles[b, scenes.order[b, k].place].kind != NOTHING:
        k += 1
        if k == scenes.vehicles.shape[1]:
            raise ValueError("more vehicles are on the intersection than there is room for")
    i = scenes.order[b, k].place
    put_on_lane(scenes, b, i, IDM, lane, s, speed)
    plan_route(scenes, b, i, routes, destination)
    draw_behaviour(scenes, b, i)


@compiled_of_scenes
def _start(
    scenes: Scenes, rows: Ints, rule: Rule, starts: Floats, entries: Ints, routes: Ints
) -> None:
    """[`IntersectionEnv._make_vehicles`]"""
    road, places = scenes.road, scenes.vehicles.shape[1]
    for b in rows:
        scenes.steps[b] = 0
        for i in range(places):
            scenes.vehicles[b, i].kind = NOTHING
            scenes.order[b, i].place = (i + rule.egos) % places  # the egos come last
        for along in starts:
            enter(scenes, b, entries, routes, along, CHANCE, (1.0, 1.0), False)
        here = here_of(scenes, b)
        for i in range(places):
            forget(here, i)
        advance(scenes.road, scenes.steps, b, here, rule.warm_up_steps)
        enter(scenes, b, entries, routes, CHALLENGER_ALONG_M, 1.0, (0.1, 0.0), True)
        for ego in range(rule.egos):
            lane, destination = entries[ego % _SIDES], rule.destination
            if destination < 0:
                destination = integers(scenes.generator[b], 1, _SIDES)
            s = EGO_ALONG_M + 5.0 * normal(scenes.generator[b], 1.0, 1.0)
            put_on_lane(scenes, b, ego, COMMANDED, lane, s, road.lanes[lane].speed_limit)
            plan_route(scenes, b, ego, routes, destination)
            own = scenes.vehicles[b, ego]
            for i in range(rule.egos, places):
                other = scenes.vehicles[b, i]
                dx, dy = other.x - own.x, other.y - own.y
                if math.sqrt(dx * dx + dy * dy) < EGO_SPACE_M:
                    other.kind = NOTHING
        tidy(scenes, b)


@compiled_of_scenes
def _follow(
    scenes: Scenes, rows: Ints, rule: Rule, entries: Ints, exits: Bools, routes: Ints
) -> None:
    """Has vehicles leave and one enter [`_clear_vehicles`, `_spawn_vehicle`]."""
    road = scenes.road
    for b in rows:
        has_left = False
        for i in range(rule.egos, scenes.vehicles.shape[1]):
            vehicle = scenes.vehicles[b, i]
            if vehicle.kind == NOTHING or not exits[vehicle.lane]:
                continue
            s, _ = local_coordinates(road, vehicle.lane, vehicle.x, vehicle.y)
            if s >= road.lanes[vehicle.lane].length - LEAVING_M:
                vehicle.kind, has_left = NOTHING, True
        if has_left:
            tidy(scenes, b)
        enter(scenes, b, entries, routes, 0.0, rule.chance, (1.0, 1.0), False)


@compiled
def has_arrived(scenes: Scenes, b: int, i: int, exits: Bools) -> bool:
    """Whether a vehicle is behind the intersection [`IntersectionEnv.has_arrived`]."""
    vehicle = scenes.vehicles[b, i]
    s, _ = local_coordinates(scenes.road, vehicle.lane, vehicle.x, vehicle.y)
    return bool(exits[vehicle.lane] and s >= ARRIVED_M)


@compiled_of_scenes
def _have_arrived(scenes: Scenes, exits: Bools) -> Bools:
    """(B,) whether the first egos have arrived."""
    found = np.empty(scenes.vehicles.shape[0], dtype=np.bool_)
    for b in range(found.size):
        found[b] = has_arrived(scenes, b, 0, exits)
    return found


@compiled_of_scenes
def _judge(
    scenes: Scenes,
    rows: Ints,
    reward: Reward,
    exits: Bools,
    rewards: Floats,
    have_arrived: Bools,
    out: Floats,
) -> None:
    """[`IntersectionEnv._reward`, `IntersectionEnv._rewards`]

    Also fills in the rewards (B, A) of each ego, and whether it has arrived.
    """
    row, egos = np.zeros(1 + reward.weights.size), rewards.shape[1]
    collision, arrival = reward.weights[0], reward.weights[2]
    for b in rows:
        out[b] = 0.0
        for ego in range(egos):
            vehicle = scenes.vehicles[b, ego]
            arrived = has_arrived(scenes, b, ego, exits)
            row[1] = vehicle.crashed
            row[2] = speed_term(reward, vehicle.speed)
            row[3] = arrived
            row[4] = is_on_own_lane(scenes, b, ego)
            total = arrival if arrived else weighted(reward.weights, row)
            total *= row[4]
            if reward.normalises:
                total = to_unit_interval(total, collision, arrival)
            row[0] = rewards[b, ego] = total
            have_arrived[b, ego] = arrived
            for k in range(row.size):
                out[b, k] += row[k]
        for k in range(row.size):
            out[b, k] /= egos
