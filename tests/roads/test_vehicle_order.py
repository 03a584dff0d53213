"""Neighbours and collisions on networks are those that a plain scan of all vehicles finds."""

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from city import city
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.locating import forget
from charms_bench.roads.scenes import (
    FEW_CONNECTED,
    FEW_VEHICLES,
    IDM,
    LANDMARK,
    NOTHING,
    OBSTACLE,
    Scenes,
    here_of,
    place,
)
from charms_bench.roads.stepping import collide, collide_pair, vehicle_of
from charms_bench.roads.vehicle_order import neighbours
from charms_bench.world.profile import HIGHWAY_ENV
from charms_bench.world.road import NEIGHBOUR_MARGIN_M, is_on_lane, local_coordinates, position
from charms_bench.world.road_network import Network, SineLane, StraightLane, network_of

SIZES = (FEW_CONNECTED, FEW_CONNECTED + 1, 4 * FEW_VEHICLES)


@compiled_of_scenes
def ask_all(scenes: Scenes, moved: int, found: Ints) -> None:
    """Finds the neighbours (N, L, 2) of all vehicles on all lanes, after some have moved."""
    here = here_of(scenes, 0)
    for i in range(moved):
        forget(here, i)
    for i in range(here.places):
        for lane in range(here.lane_count):
            found[i, lane, 0], found[i, lane, 1] = neighbours(here, i, lane)


@compiled_of_scenes
def collide_all(scenes: Scenes) -> None:
    collide(here_of(scenes, 0))


@compiled_of_scenes
def collide_as_listed(scenes: Scenes, first: int, second: int, dt: float) -> None:
    here = here_of(scenes, 0)
    collide_pair(vehicle_of(here, first), vehicle_of(here, second), dt)


@cache
def roads() -> dict[str, Network]:
    """A motorway with a ramp that swings towards it, and a town."""
    motorway = [
        (start, end, StraightLane(start=(x, y), end=(x + 150, y)))
        for x, start, end in ((0, "a", "b"), (150, "b", "c"))
        for y in (0, 4, 8)
    ]
    swings = {"amplitude": 2.0, "pulsation": 0.02, "phase": 1.5}
    ramp = [
        ("j", "k", StraightLane(start=(0, 14), end=(80, 14))),
        ("k", "b", SineLane(start=(80, 12), end=(150, 12), **swings)),
    ]
    return {"motorway": network_of(motorway + ramp), "city": city(2)}


def scenes_of(name: str, connects: bool, vehicles: int, rng: np.random.Generator) -> Scenes:
    """A scene of vehicles, obstacles and empty places near lanes, some at one position."""
    road = roads()[name]
    constants = HIGHWAY_ENV.constants(1 / 15)
    scenes = Scenes.empty(1, vehicles, road, connects, np.array([20.0, 25.0]), constants)
    kinds = rng.choice([NOTHING, LANDMARK, OBSTACLE, IDM, IDM, IDM], vehicles)
    where: list[tuple[float, float]] = []
    for i in range(vehicles):
        lane = int(rng.integers(road.lanes.size))
        s = rng.uniform(-8, road.lanes["length"][lane] + 8)
        x, y = position(road, lane, s, rng.choice([0.0, rng.uniform(-4, 4)]))
        if where and rng.random() < 0.3:
            x, y = where[int(rng.integers(len(where)))]
        where.append((x, y))
        place(scenes, 0, i, int(kinds[i]), x, y, rng.uniform(-0.2, 0.2), rng.uniform(0, 30))
        scenes.vehicles[0, i]["checks_collisions"] = rng.random() < 0.8
    scenes.order["place"][0] = rng.permutation(vehicles)
    return scenes


@compiled
def plain_scan(
    road: Network, x: Floats, y: Floats, kind: Ints, i: int, lane: int, lanes: Ints, offsets: Floats
) -> tuple[int, int]:
    """[`Road.neighbour_vehicles`] of highway-env, which looks at all vehicles."""
    s, _ = local_coordinates(road, lane, x[i], y[i])
    front = rear = -1
    s_front = s_rear = 0.0
    for j in range(x.size):
        if j == i or kind[j] < OBSTACLE:
            continue
        for k in range(lanes.size):
            if is_on_lane(road, lanes[k], x[j], y[j], NEIGHBOUR_MARGIN_M):
                other = local_coordinates(road, lanes[k], x[j], y[j])[0] + offsets[k]
                if s <= other and (front < 0 or other <= s_front):
                    front, s_front = j, other
                if other < s and (rear < 0 or other > s_rear):
                    rear, s_rear = j, other
                break
    return front, rear


@pytest.mark.parametrize("vehicles", SIZES)
@pytest.mark.parametrize("connects", [False, True])
@pytest.mark.parametrize("name", ["motorway", "city"])
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_neighbours_are_those_of_a_plain_scan(
    name: str, connects: bool, vehicles: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    scenes = scenes_of(name, connects, vehicles, rng)
    lanes = scenes.road.lanes.size
    asked = rng.integers((vehicles, lanes), size=(40, 2)).tolist()
    for _ in range(3):
        found = np.empty((vehicles, lanes, 2), dtype=np.int64)
        ask_all(scenes, vehicles, found)
        x, y, kind = (scenes.vehicles[name][0].copy() for name in ("x", "y", "kind"))
        for i, lane in asked:
            search = scenes.searches[lane]
            connected = scenes.connected[search["first"] : search["after"]]
            ways = connected["lane"].copy(), connected["offset"].copy()
            assert tuple(found[i, lane]) == plain_scan(scenes.road, x, y, kind, i, lane, *ways)
        scenes.vehicles["x"] += rng.normal(0, 3, (1, vehicles))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), vehicles=st.sampled_from(SIZES))
def test_collisions_are_those_of_all_pairs_in_their_order(seed: int, vehicles: int) -> None:
    scenes = scenes_of("motorway", False, vehicles, np.random.default_rng(seed))
    before = scenes.vehicles.copy()
    collide_all(scenes)
    found = scenes.vehicles.copy()
    scenes.vehicles[:] = before
    for first, second in pairs(scenes):
        collide_as_listed(scenes, first, second, float(scenes.constants["dt"][0]))
    np.testing.assert_array_equal(found, scenes.vehicles)
    assert vehicles < max(SIZES) or found["crashed"].any()


def pairs(scenes: Scenes) -> Iterator[tuple[int, int]]:
    """The pairs that can collide, in highway-env's order of vehicles."""
    rows: NDArray[np.void] = scenes.vehicles[0]
    order = scenes.order["place"][0].tolist()
    for k, first in enumerate(order):
        for second in order[k + 1 :]:
            checks = rows["checks_collisions"][first] or rows["checks_collisions"][second]
            are_there = rows["kind"][first] > OBSTACLE and rows["kind"][second] >= OBSTACLE
            if checks and are_there:
                yield first, second


def test_a_town_has_400_lanes_whose_ends_meet() -> None:
    road = city(6)
    assert road.lanes.size >= 400
    for lane in range(road.lanes.size):
        row = road.lanes[lane]
        end = position(road, lane, row["length"], 0.0)
        for following in road.successors[row["next_roads"] : row["next_roads"] + row["next_count"]]:
            assert position(road, int(following), 0.0, 0.0) == pytest.approx(end)
