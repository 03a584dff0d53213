"""Roads, obstacles, default configurations and constants are exactly those of highway-env."""

import json
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers its environments
import numpy as np
import pytest
from drawn_configurations import random_configuration
from highway_env.vehicle import behavior
from stock_networks import road_of

from charms_bench.errors import InputError
from charms_bench.roads import TASKS
from charms_bench.roads.configuration import checked, plain
from charms_bench.roads.defaults import DEFAULTS, MOST_STEPS, SPLIT
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.layout import Layout
from charms_bench.roads.linear_vehicles import LINEAR, TIME_HEADWAY_S
from charms_bench.roads.scenes import KINDS, LANDMARK
from charms_bench.testing.stock_roads import unchanged_idm
from charms_bench.world.road_network import StraightLane

CONFIGURED = (
    *("highway-v0", "highway-fast-v0", "exit-v0", "merge-generic-v1", "roundabout-generic-v1"),
    *("racetrack-large-v0", "racetrack-oval-v1", "parking-v0"),
)
"""Environments whose roads or obstacles follow their configurations."""
Made = tuple[Any, ...]
"""The names of the lanes, their table, successors, shortest ways between all nodes, and objects."""


def stocks(name: str, configs: Sequence[Mapping[str, Any]]) -> Iterator[Any]:
    """highway-env's environment with one configuration after the other."""
    with unchanged_idm():
        made: Any = gymnasium.spec(name).make(disable_env_checker=True).unwrapped
        default = dict(made.config)
        for config in configs:
            made.config = {**default, **config}
            made.reset()
            yield made


def made_by_highway_env(name: str, configs: Sequence[Mapping[str, Any]]) -> list[Made]:
    found = []
    empty: dict[str, Any] = {"vehicles_count": 0, "other_vehicles": 0, "initial_vehicle_count": 0}
    empty |= {"observation": {"type": "Kinematics"}}
    for each in stocks(name, [{**config, **empty} for config in configs]):
        road = each.road
        table, names = road_of(road.network), list(road.network.lanes_dict())
        objects = [
            (type(each).__name__.lower(), *each.position, each.heading, each.LENGTH, each.WIDTH)
            for each in road.objects
        ]
        paths = [road.network.shortest_path(*pair) for pair in pairs(names)]
        found.append((names, *map(np.ndarray.tobytes, table), paths, objects))
    return found


def made_here(name: str, config: Mapping[str, Any]) -> Made:
    task = Episodes(name, 1, config).task
    table, names = task.layout.network, list(task.lanes)
    objects = [(KINDS[each.kind], *each[:-1]) for each in task.objects]
    paths = [task.layout.shortest_path(*pair) for pair in pairs(names)]
    return names, *map(np.ndarray.tobytes, table), paths, objects


def pairs(names: list[Any]) -> Any:
    nodes = sorted({node for start, end, _ in names for node in (start, end)})
    return product(nodes, [*nodes, "nowhere"])


def assert_same_roads(
    process: ProcessPoolExecutor, name: str, configs: Sequence[Mapping[str, Any]]
) -> None:
    theirs = process.submit(made_by_highway_env, name, configs).result()
    for config, (*expected, objects) in zip(configs, theirs, strict=True):
        *found, own = made_here(name, config)
        assert found == expected, config
        is_goal = [each[0] == KINDS[LANDMARK] for each in objects]  # drawn in each episode
        moved = [a if moves else b for a, b, moves in zip(objects, own, is_goal, strict=True)]
        assert objects == moved, config


@pytest.mark.parametrize("name", TASKS)
def test_a_road_is_that_of_highway_env(process: ProcessPoolExecutor, name: str) -> None:
    assert_same_roads(process, name, [{}])


@pytest.mark.parametrize("name", CONFIGURED)
def test_a_road_follows_its_configuration_as_in_highway_env(
    process: ProcessPoolExecutor, name: str
) -> None:
    configs = [random_configuration(name, seed) for seed in range(30)]
    for seed, config in enumerate(configs):
        del config["action"]
        for key in config:
            if key.endswith(("length", "radius")):
                config[key] += seed / 7
    assert_same_roads(process, name, configs)


@pytest.mark.parametrize("name", TASKS)
def test_defaults_are_those_of_highway_env(name: str) -> None:
    spec, [stock] = gymnasium.spec(name), [*stocks(name, [{}])]
    # As text, 1 is not 1.0, and keys have an order.
    assert json.dumps(checked(DEFAULTS[name], None)) == json.dumps(plain(stock.config))
    assert MOST_STEPS.get(name) == spec.max_episode_steps
    assert (name in SPLIT) == bool(spec.additional_wrappers)


@pytest.mark.parametrize("name", LINEAR)
def test_linear_vehicles_have_the_constants_of_highway_env(name: str) -> None:
    theirs, own = getattr(behavior, name), LINEAR[name]
    ranges = np.concatenate([theirs.ACCELERATION_RANGE, theirs.STEERING_RANGE], axis=1)
    gains = [*theirs.ACCELERATION_PARAMETERS, *theirs.STEERING_PARAMETERS]
    np.testing.assert_array_equal(own.gains, [gains, ranges[0], ranges[1] - ranges[0]])
    assert theirs.TIME_WANTED == TIME_HEADWAY_S
    assert own.lane_change_gain_mps2 == theirs.LANE_CHANGE_MIN_ACC_GAIN


@pytest.mark.parametrize(
    ("name", "config", "what"),
    [
        ("highway-v0", {"lanes_count": 0}, "lanes_count: 0; expected at least 1"),
        ("highway-v0", {"lanes_count": 2.5}, "lanes_count: 2.5; expected a whole number"),
        ("highway-v0", {"vehicles_count": 3.0}, "vehicles_count: 3.0; expected a whole number"),
        ("highway-v0", {"initial_lane_id": 4}, "not all values can be used"),
        ("exit-v1", {"lanes_count": 1}, "lanes_count: 1; expected at least 2"),
        ("merge-generic-v0", {"converge_merge_length": 0}, "0; expected more than 0"),
        ("merge-generic-v0", {"after_merge_length": 80}, "80; expected at least 90"),
        ("merge-v0", {"reward_speed_range": ["20", "30"]}, "'20'; expected a number"),
        ("merge-v0", {"reward_speed_range": 20}, "highway-env does not start with it"),
        ("roundabout-v0", {"incoming_vehicle_destination": 3}, "not all values can be used"),
        ("roundabout-generic-v0", {"roundabout_lanes": 0}, "0; expected at least 1"),
        ("roundabout-generic-v0", {"roundabout_radius": 0}, "a lane would be a point"),
        ("parking-v0", {"reward_weights": [1] * 7}, "expected 6 numbers"),
    ],
)
def test_what_highway_env_does_not_start_with_is_rejected(
    name: str, config: dict[str, Any], what: str
) -> None:
    with pytest.raises(Exception, match=r"."):
        next(stocks(name, [config]))
    with pytest.raises(InputError, match=f"^config.*{what}"):
        Episodes(name, 1, config)


def test_the_last_exit_can_be_counted_from_the_end_as_in_highway_env() -> None:
    last, counted = (
        Episodes("roundabout-v0", 4, {"incoming_vehicle_destination": each}) for each in (2, -1)
    )
    for episodes in (last, counted):
        episodes.seed(episodes.everyone, np.arange(4, dtype=np.uint64))
        episodes.start(episodes.everyone)
    assert (last.scenes.vehicles == counted.scenes.vehicles).all()


def test_the_first_in_the_alphabet_of_the_shortest_ways_is_found() -> None:
    lane = StraightLane(start=(0, 0), end=(1, 0))
    ways = ("ac", "ab", "cz", "bd", "bz", "dz", "za")
    layout = Layout((start, end, lane) for start, end in ways)
    assert layout.shortest_path("a", "z") == ["a", "b", "z"]
    assert layout.shortest_path("z", "d") == ["z", "a", "b", "d"]
    assert layout.shortest_path("a", "a") == layout.shortest_path("a", "y") == []
