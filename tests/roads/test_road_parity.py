"""highway-env's other roads, seed for seed and bit for bit."""

from importlib import import_module
from typing import Any

import numpy as np
import pytest

from charms_bench.roads import TASKS
from charms_bench.roads.episodes import Episodes
from charms_bench.testing.road_parity import compare, verify_road

CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "highway-fast-v0": {"initial_lane_id": 1, "normalize_reward": False, "offroad_terminal": True},
    "merge-generic-v0": {"lanes_count": 3, "vehicles_count": 8, "converge_merge_length": 60},
    "exit-v0": {"lanes_count": 4, "vehicles_count": 12, "vehicles_density": 1.2},
    "u-turn-v1": {"normalize_reward": False, "policy_frequency": 3, "duration": 5},
    "roundabout-generic-v1": {"roundabout_radius": 30, "roundabout_lanes": 3, "vehicles_count": 9},
    "two-way-v0": {"observation": {"type": "Kinematics", "see_behind": True, "clip": False}},
    "roundabout-v0": {"action": {"type": "DiscreteMetaAction", "lateral": False}},
}


@pytest.mark.parametrize("name", TASKS)
def test_episodes_are_those_of_highway_env_to_the_last_bit(name: str) -> None:
    found = verify_road(name, 4, workers=1)
    assert found.episodes == 4
    assert found.decisions > 4
    assert found.differing == []
    assert found.largest == 0.0


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_they_are_with_other_configurations_too(name: str) -> None:
    found = verify_road(name, 4, seed=100, workers=1, config=CONFIGURATIONS[name])
    assert found.differing == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_200_episodes_are_those_of_highway_env_to_the_last_bit(name: str) -> None:
    assert verify_road(name, 200).differing == []


def random_configuration(name: str, seed: int) -> dict[str, Any]:
    """Values for the keys that an environment of that name documents."""
    rng = np.random.default_rng(seed)
    speeds = sorted(map(float, rng.choice(np.arange(0, 40, 2), rng.integers(2, 5), replace=False)))
    axes = {"longitudinal": True, "lateral": bool(rng.random() < 0.7)}
    config: dict[str, Any] = {
        "policy_frequency": int(rng.integers(1, 6)),
        "simulation_frequency": int(rng.integers(5, 21)),
        "collision_reward": float(-rng.random()),
        "high_speed_reward": float(rng.random()),
        "neighbour_vehicles_connected_lanes": bool(rng.random() < 0.5),
        "action": {"type": "DiscreteMetaAction", "target_speeds": speeds, **axes},
    }
    if rng.random() < 0.7:
        flags = ("absolute", "normalize", "clip", "see_behind", "include_obstacles")
        features = ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"]
        config["observation"] = {
            "type": "Kinematics",
            "features": features[: rng.integers(3, 9)],
            "vehicles_count": int(rng.integers(2, 10)),
            **{flag: bool(rng.random() < 0.5) for flag in flags},
        }
    else:
        config["observation"] = {"type": "TimeToCollision", "horizon": int(rng.integers(3, 12))}
    motorway = {
        "lanes_count": int(rng.integers(1, 6)),
        "vehicles_count": int(rng.integers(1, 30)),
        "vehicles_density": float(rng.uniform(0.5, 2)),
        "ego_spacing": float(rng.uniform(1, 3)),
        "initial_lane_id": 0 if rng.random() < 0.5 else None,
        "normalize_reward": bool(rng.random() < 0.5),
        "offroad_terminal": bool(rng.random() < 0.5),
        "duration": int(rng.integers(5, 20)),
        "reward_speed_range": [15, 28],
    }
    own: dict[str, dict[str, Any]] = {
        "highway": motorway,
        "highway-fast": motorway,
        "merge": {"merging_speed_reward": -0.4, "reward_speed_range": [15, 28]},
        "merge-generic": {
            "lanes_count": int(rng.integers(1, 5)),
            "vehicles_count": int(rng.integers(0, 9)),
            "before_merge_length": int(rng.integers(60, 200)),
            "converge_merge_length": int(rng.integers(40, 120)),
            "parallel_merge_length": int(rng.integers(40, 120)),
            "after_merge_length": int(rng.integers(90, 200)),
        },
        "two-way": {"left_lane_reward": 0.3},
        "exit": {
            "lanes_count": int(rng.integers(2, 7)),
            "vehicles_count": int(rng.integers(1, 20)),
            "vehicles_density": float(rng.uniform(0.5, 2)),
            "ego_spacing": float(rng.uniform(1, 3)),
            "normalize_reward": bool(rng.random() < 0.5),
        },
        "u-turn": {"duration": int(rng.integers(2, 12)), "reward_speed_range": [4, 20]},
        "roundabout": {"incoming_vehicle_destination": int(rng.integers(3))},
        "roundabout-generic": {
            "roundabout_radius": int(rng.integers(15, 40)),
            "roundabout_lanes": int(rng.integers(1, 4)),
            "vehicles_count": int(rng.integers(0, 12)),
            "normalize_reward": bool(rng.random() < 0.5),
        },
    }
    return config | own[name.rpartition("-")[0]]


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in TASKS if name.endswith("v0")])
def test_100_random_configurations_give_the_same_episodes(name: str) -> None:
    for seed in range(100):
        config = random_configuration(name, seed)
        found = verify_road(name, 1, seed, workers=1, config=config)
        assert found.differing == [], config


@pytest.mark.parametrize("name", TASKS)
def test_scenes_start_as_in_highway_env_with_its_own_mathematics(name: str) -> None:
    found = compare(name, range(20), decisions=0, tolerance=1e-9)
    assert found.differing == []
    assert found.largest_at_start <= 1e-9


def test_highway_env_computes_with_numpy_again_after_its_road_was_read() -> None:
    Episodes("merge-v0", 1)
    assert import_module("highway_env.road.lane").np is np
    assert import_module("highway_env.envs.merge_env").np is np
