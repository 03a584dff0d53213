"""Roads and highway-env's own answer the same questions; `test_road_rules` runs these tests.

highway-env has to start with `worker_environment()` to give the same bits.
"""

from typing import Any

import numpy as np
import pytest
from highway_env import envs
from highway_env.road import lane as highway_env_lanes
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st
from stock_networks import road_of

from charms_bench.foundation.compiled import compiled
from charms_bench.testing.exact_maths import use_exact_maths
from charms_bench.testing.reference_engine import highway_env_network
from charms_bench.world import road as questions
from charms_bench.world.road import Road, Straight

use_exact_maths()

ENVIRONMENTS = (
    envs.MergeEnv,
    envs.RoundaboutEnv,
    envs.IntersectionEnv,
    envs.ExitEnv,
    envs.RacetrackEnv,
    envs.TwoWayEnv,
    envs.LaneKeepingEnv,
    envs.UTurnEnv,
)
NUMBERS = st.floats(-300, 300)
POINTS = st.tuples(NUMBERS, NUMBERS)
PHASES = st.floats(-7, 7)
COMMON: dict[str, Any] = {
    "speed_limit": st.floats(1, 50),
    "priority": st.integers(-1, 5),
    "forbidden": st.booleans(),
}
WIDTHS = {"width": st.floats(2, 8)}


@st.composite
def straight_lanes(draw: st.DrawFn, kind: Any, **more: Any) -> Any:
    start, way = draw(POINTS), draw(POINTS.filter(lambda way: max(map(abs, way)) > 1))
    end = (start[0] + way[0], start[1] + way[1])
    return draw(st.builds(kind, st.just(start), st.just(end), **more, **COMMON, **WIDTHS))


@st.composite
def polylines(draw: st.DrawFn, kind: Any) -> Any:
    """Points that turn by at most 1 rad; the boundaries, if there are any, are beside them."""
    bends = draw(st.lists(st.tuples(st.floats(-1, 1), st.floats(0.6, 15)), min_size=2, max_size=6))
    headings = draw(PHASES) + np.cumsum([bend for bend, _ in bends])
    steps = [
        size * np.array([np.cos(a), np.sin(a)])
        for a, (_, size) in zip(headings, bends, strict=True)
    ]
    points = np.cumsum([draw(POINTS), *steps], axis=0)
    boundaries = [points + draw(POINTS) for _ in range(2)] if kind is POLY else []
    width = WIDTHS if kind is FIXED else {}
    lines = [list(map(tuple, each.tolist())) for each in (points, *boundaries)]
    return draw(st.builds(kind, *map(st.just, lines), **COMMON, **width))


FIXED, POLY = highway_env_lanes.PolyLaneFixedWidth, highway_env_lanes.PolyLane
LANES = {
    "straight": straight_lanes(highway_env_lanes.StraightLane),
    "sine": straight_lanes(
        highway_env_lanes.SineLane,
        amplitude=st.floats(-20, 20),
        pulsation=st.floats(-2, 2),
        phase=PHASES,
    ),
    "circular": st.builds(
        highway_env_lanes.CircularLane,
        POINTS,
        st.floats(1, 300),
        PHASES,
        PHASES,
        st.booleans(),
        **COMMON,
        **WIDTHS,
    ),
    "polyline": polylines(FIXED),
    "polyline of several widths": polylines(POLY),
}


@compiled
def _answers(
    road: Any, lane: int, s: float, r: float, x: float, y: float, heading: float, margin: float
) -> Any:
    return (
        questions.position(road, lane, s, r),
        questions.heading_at(road, lane, s),
        questions.width_at(road, lane, s),
        questions.local_coordinates(road, lane, x, y),
        questions.is_on_lane(road, lane, x, y, margin),
        questions.is_reachable(road, lane, x, y),
        questions.distance(road, lane, x, y),
        questions.distance_with_heading(road, lane, x, y, heading),
    )


@compiled
def _closest_lanes(road: Any, x: Any, y: Any, heading: Any, found: Any) -> None:
    for i in range(x.size):
        found[i] = questions.closest_lane(road, x[i], y[i], heading[i])


@compiled
def _next_lanes(
    road: Any, lane: Any, next_road: Any, next_id: Any, x: Any, y: Any, found: Any
) -> None:
    for i in range(x.size):
        found[i] = questions.next_lane(road, lane[i], next_road[i], next_id[i], x[i], y[i])


def of_highway_env(
    lane: Any, s: float, r: float, x: float, y: float, heading: float, margin: float
) -> tuple[Any, ...]:
    point = np.array([x, y])
    return (
        tuple(map(float, lane.position(s, r))),
        lane.heading_at(s),
        lane.width_at(s),
        tuple(map(float, lane.local_coordinates(point))),
        lane.on_lane(point, margin=margin),
        lane.is_reachable_from(point),
        lane.distance(point),
        lane.distance_with_heading(point, heading),
    )


def assert_same_answers(road: Road, number: int, lane: Any, draw: st.DataObject) -> None:
    s = draw.draw(st.one_of(st.floats(-50, abs(lane.length) + 50), st.integers(-3, 60).map(float)))
    r, margin = draw.draw(st.floats(-20, 20)), draw.draw(st.sampled_from([0.0, 1.0, -0.5]))
    beside = st.floats(-12, 12).map(lambda aside: tuple(map(float, lane.position(s, aside))))
    x, y = draw.draw(st.one_of(POINTS, beside))
    asked = (s, r, x, y, draw.draw(st.floats(-20, 20)), margin)
    expected = of_highway_env(lane, *asked)
    assert _answers(road, number, *asked) == expected
    assert _answers.py_func(road, number, *asked) == expected  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", LANES)
def test_a_lane_gives_the_same_bits(kind: str) -> None:
    @settings(derandomize=True, deadline=None, max_examples=100)
    @given(LANES[kind], st.data())
    def compare(lane: Any, draw: st.DataObject) -> None:
        network = RoadNetwork()
        network.add_lane("a", "b", lane)
        road = road_of(network)
        row = road.lanes[0]
        for name in ("length", "speed_limit", "priority", "forbidden"):
            assert row[name] == getattr(lane, name)
        assert_same_answers(road, 0, lane, draw)

    compare()


STRAIGHT_ROADS = st.builds(
    Straight, st.integers(1, 6), st.sampled_from([4.0, 3.7]), st.floats(50, 900), st.floats(1, 40)
)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(STRAIGHT_ROADS, st.data())
def test_a_straight_road_gives_the_same_bits(road: Straight, draw: st.DataObject) -> None:
    lanes = highway_env_network(road).lanes_list()
    number = draw.draw(st.integers(0, road.lanes - 1))
    assert_same_answers(road, number, lanes[number], draw)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(STRAIGHT_ROADS, st.floats(0, 1), st.floats(-10, 40))
def test_the_nearest_lane_of_a_straight_road_is_the_same(
    road: Straight, along: float, y: float
) -> None:
    x = along * road.road_length
    expected = highway_env_network(road).get_closest_lane_index(np.array([x, y]), 0.0)[2]
    assert questions.closest_lane(road, x, y, 0.0) == expected
    assert questions.next_lane(road, expected, -1, -1, x, y) == expected


@pytest.fixture(scope="module", params=ENVIRONMENTS, ids=lambda kind: kind.__name__)
def network(request: pytest.FixtureRequest) -> RoadNetwork:
    return request.param().unwrapped.road.network


def near(network: RoadNetwork, count: int) -> tuple[Any, Any, Any]:
    """Points beside the lanes and beyond their ends, and headings."""
    rng, lanes = np.random.default_rng(0), network.lanes_list()
    chosen = [lanes[k] for k in rng.integers(0, len(lanes), count)]
    along, aside = rng.uniform(-0.2, 1.2, count), rng.normal(0, 6, count)
    points = [
        lane.position(k * lane.length, r) for lane, k, r in zip(chosen, along, aside, strict=True)
    ]
    headings = [lane.heading_at(k * lane.length) for lane, k in zip(chosen, along, strict=True)]
    x, y = np.array(points).T
    return x, y, np.array(headings) + rng.choice([0.0, 0.3, 3.0], count)


def test_the_closest_lanes_of_an_environment_are_the_same(network: RoadNetwork) -> None:
    x, y, heading = near(network, 300)
    found, names = np.empty(x.size, dtype=np.int64), list(network.lanes_dict())
    _closest_lanes(road_of(network), x, y, heading, found)
    for i, lane in enumerate(found):
        expected = network.get_closest_lane_index(np.array([x[i], y[i]]), heading[i])
        assert names[lane] == expected


@pytest.mark.parametrize("has_route", [False, True])
def test_the_next_lanes_of_an_environment_are_the_same(
    network: RoadNetwork, has_route: bool
) -> None:
    x, y, _ = near(network, 300)
    rng, names = np.random.default_rng(2), list(network.lanes_dict())
    lane = rng.integers(0, len(names), x.size)
    next_road, next_id, found = np.full((3, x.size), -1)
    routes: list[Any] = [None] * x.size
    for i, (_, end, _) in enumerate(names[k] for k in lane):
        if has_route and end in network.graph:
            after = rng.choice(list(network.graph[end]))
            number = rng.choice([None, 0])
            next_road[i], next_id[i] = names.index((end, after, 0)), -1 if number is None else 0
            routes[i] = [(end, after, number)]
    _next_lanes(road_of(network), lane, next_road, next_id, x, y, found)
    for i, row in enumerate(lane):
        point = np.array([x[i], y[i]])
        assert names[found[i]] == network.next_lane(names[row], routes[i], point)


def test_the_side_lanes_of_an_environment_are_the_same(network: RoadNetwork) -> None:
    road, names = road_of(network), list(network.lanes_dict())
    for lane, name in enumerate(names):
        found = [names[side] for side in questions.side_lanes(road, lane) if side >= 0]
        assert found == network.side_lanes(name)
