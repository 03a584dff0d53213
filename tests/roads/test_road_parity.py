"""highway-env's other roads, seed for seed and bit for bit, beside highway-env itself.

All but one comparison are slow; `tests/golden` compares with what highway-env did when it was
recorded.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from charms_bench.roads import TASKS
from charms_bench.roads.episodes import Episodes
from charms_bench.testing.road_parity import (
    Comparison,
    compare,
    difference,
    verify_road,
)

CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "highway-fast-v0": {"initial_lane_id": 1, "normalize_reward": False, "offroad_terminal": True},
    "merge-generic-v0": {"lanes_count": 3, "vehicles_count": 8, "converge_merge_length": 60},
    "exit-v0": {"lanes_count": 4, "vehicles_count": 12, "vehicles_density": 1.2},
    "u-turn-v1": {"normalize_reward": False, "policy_frequency": 3, "duration": 5},
    "roundabout-generic-v1": {"roundabout_radius": 30, "roundabout_lanes": 3, "vehicles_count": 9},
    "two-way-v0": {"observation": {"type": "Kinematics", "see_behind": True, "clip": False}},
    "roundabout-v0": {"action": {"type": "DiscreteMetaAction", "lateral": False}},
    "racetrack-v0": {"action": {"type": "ContinuousAction", "dynamical": True}},
    "racetrack-v1": {"action": {"type": "DiscreteAction", "actions_per_axis": 5}},
    "racetrack-oval-v0": {
        "observation": {
            "type": "OccupancyGrid",
            "features": ["vx", "on_road", "presence", "sin_h", "x"],
            "features_range": {"x": [-20, 30], "vx": [-10, 10]},
            "as_image": True,
        },
        "block_lane": True,
        "force_decision": True,
        "other_vehicles": 12,
    },
    "parking-v0": {
        "action": {"type": "ContinuousAction", "dynamical": True},
        "observation": {
            "type": "KinematicsGoal",
            "features": ["cos_h", "presence", "vy"],
            "scales": [2, 1, 7.5],
        },
    },
    "lane-keeping-v0": {
        "observation": {
            "type": "AttributesObservation",
            "attributes": ["derivative", "reference_state", "state", "derivative"],
        },
        "state_noise": 0.4,
        "policy_frequency": 3,
    },
    "parking-parked-v0": {"vehicles_count": 40, "add_walls": False},
    "racetrack-large-v1": {
        "observation": {"type": "Kinematics", "features": ["x", "y", "cos_h"]},
        "speed_limit": 14,
        "terminate_off_road": False,
        "collision_reward": -0.3,
    },
}
LINEAR = [
    {"other_vehicles_type": f"highway_env.vehicle.behavior.{kind}Vehicle"}
    for kind in ("Linear", "Aggressive", "Defensive")
]
LINEAR_ROADS = (
    *("highway-fast-v0", "merge-v0", "merge-generic-v1", "two-way-v0", "exit-v0", "u-turn-v1"),
    *("roundabout-v0", "roundabout-generic-v1", "intersection-v0", "intersection-multi-agent-v2"),
)
"""One of each kind of road where `other_vehicles_type` counts."""
Compared = Callable[..., Comparison]
RATES = ("simulation_frequency", "policy_frequency")
FEATURES = ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"]


def test_episodes_are_those_of_highway_env_to_the_last_bit(compared: Compared) -> None:
    found = compared("merge-v0", range(2))
    assert found.episodes == 2
    assert found.decisions > 2
    assert found.differing == []
    assert found.largest == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_they_are_with_other_configurations_too(name: str, compared: Compared) -> None:
    assert compared(name, range(100, 102), config=CONFIGURATIONS[name]).differing == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", LINEAR)
def test_a_racetrack_has_idm_vehicles_whatever_their_type(
    kind: dict[str, Any], compared: Compared
) -> None:
    assert compared("racetrack-v0", range(1), config=kind).differing == []


@pytest.mark.slow
@pytest.mark.parametrize("name", LINEAR_ROADS)
@pytest.mark.parametrize("kind", LINEAR)
def test_200_episodes_of_linear_vehicles_do(name: str, kind: dict[str, Any]) -> None:
    assert verify_road(name, 200, config=kind).differing == []


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
        "neighbour_vehicles_connected_lanes": bool(rng.random() < 0.5),
    }
    if name.startswith("racetrack"):
        return config | random_racetrack(name, rng)
    if name.startswith("parking"):
        return config | random_parking(rng)
    if name.startswith("lane-keeping"):
        return {name: config[name] for name in RATES} | random_lane_keeping(rng)
    config["high_speed_reward"] = float(rng.random())
    config["action"] = {"type": "DiscreteMetaAction", "target_speeds": speeds, **axes}
    if rng.random() < 0.7:
        config["observation"] = random_kinematics(rng)
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


def random_kinematics(rng: np.random.Generator) -> dict[str, Any]:
    flags = ("absolute", "normalize", "clip", "see_behind", "include_obstacles")
    return {
        "type": "Kinematics",
        "features": FEATURES[: rng.integers(3, 9)],
        "vehicles_count": int(rng.integers(2, 10)),
        **{flag: bool(rng.random() < 0.5) for flag in flags},
    }


def random_controls(rng: np.random.Generator) -> dict[str, Any]:
    """Actions that are accelerations and steering angles."""
    axes = [(True, True), (False, True), (True, False)][rng.choice(3, p=[0.5, 0.4, 0.1])]
    action: dict[str, Any] = {
        "longitudinal": axes[0],
        "lateral": axes[1],
        "dynamical": bool(rng.random() < 0.4),
        "clip": bool(rng.random() < 0.7),
        "steering_range": [float(-rng.uniform(0.3, 1)), float(rng.uniform(0.3, 1))],
        "acceleration_range": [float(-rng.uniform(2, 6)), float(rng.uniform(1, 5))],
    }
    if rng.random() < 0.3:
        return {"type": "DiscreteAction", "actions_per_axis": int(rng.integers(2, 6)), **action}
    speeds = None if rng.random() < 0.5 else [float(rng.uniform(-5, 5)), float(rng.uniform(6, 15))]
    return {"type": "ContinuousAction", "speed_range": speeds, **action}


def random_racetrack(name: str, rng: np.random.Generator) -> dict[str, Any]:
    """The part of `random_configuration` that is particular to the racetracks."""
    names = [*rng.permutation([*FEATURES, "on_road"])[: rng.integers(1, 7)].tolist()]
    ranges = {"vx": [-10, 10], "y": [-15, 25], "heading": [-3, 3], "x": [-30, 30]}
    widths = rng.uniform(8, 40, (2, 2))
    grid = {
        "type": "OccupancyGrid",
        "features": names,
        "features_range": None if rng.random() < 0.5 else ranges,
        "grid_size": [[-float(low), float(high)] for low, high in widths],
        "grid_step": [float(rng.uniform(1.5, 6)), int(rng.integers(2, 7))],
        **{flag: bool(rng.random() < 0.5) for flag in ("align_to_vehicle_axes", "clip")},
        "as_image": bool(rng.random() < 0.3),
    }
    oval = {
        "length": int(rng.integers(60, 160)),
        "no_lanes": int(rng.integers(1, 6)),
        **{key: bool(rng.random() < 0.4) for key in ("block_lane", "force_decision")},
    }
    return {
        "action": random_controls(rng),
        "observation": grid if rng.random() < 0.8 else random_kinematics(rng),
        "other_vehicles": int(rng.integers(0, 9)),
        "lane_centering_cost": float(rng.uniform(1, 8)),
        "lane_centering_reward": float(rng.uniform(0, 2)),
        "action_reward": float(-rng.random()),
        "speed_limit": float(rng.uniform(6, 15)),
        "terminate_off_road": bool(rng.random() < 0.5),
        "duration": int(rng.integers(5, 30)),
        **(oval if "oval" in name else {}),
    }


def random_parking(rng: np.random.Generator) -> dict[str, Any]:
    """The part of `random_configuration` that is particular to the car parks."""
    names = [name for name in FEATURES if name != "heading"]
    names = rng.permutation(names)[: rng.integers(1, 7)].tolist()
    scales = [float(scale) for scale in rng.uniform(0.5, 50, len(names))]
    kinds: list[dict[str, Any]] = [
        {"type": "KinematicsGoal", "features": names, "scales": scales},
        random_kinematics(rng),
    ]
    return {
        "action": random_controls(rng)
        if rng.random() < 0.9
        else {"type": "DiscreteMetaAction", "target_speeds": [-5, 0, 5, 10]},
        "observation": kinds[rng.choice(2, p=[0.7, 0.3])],
        "vehicles_count": int(rng.integers(0, 30)),
        "reward_weights": [float(weight) for weight in rng.random(6)],
        "success_goal_reward": float(rng.uniform(0.1, 0.7)),
        "collision_reward": float(-rng.uniform(0, 9)),
        "add_walls": bool(rng.random() < 0.6),
        "duration": int(rng.integers(5, 40)),
    }


def random_lane_keeping(rng: np.random.Generator) -> dict[str, Any]:
    """The part of `random_configuration` that is particular to lane keeping."""
    names = rng.choice(["state", "derivative", "reference_state"], rng.integers(1, 5)).tolist()
    attributes = {"type": "AttributesObservation", "attributes": names}
    return {
        "action": random_controls(rng) | {"dynamical": True},
        "observation": attributes if rng.random() < 0.8 else random_kinematics(rng),
        "state_noise": float(rng.uniform(0, 0.5)),
        "derivative_noise": float(rng.uniform(0, 0.5)),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [each for each in TASKS if each.endswith("v0") and "intersection" not in each]
)
def test_100_random_configurations_give_the_same_episodes(name: str) -> None:
    for seed in range(100):
        config = random_configuration(name, seed)
        found = verify_road(name, 1, seed, workers=1, config=config)
        assert found.differing == [], config


@pytest.mark.parametrize(
    ("ours", "theirs", "apart"),
    [
        (np.inf, np.inf, 0.0),
        (np.nan, np.nan, 0.0),
        (np.inf, np.nan, np.inf),
        (-np.inf, np.inf, np.inf),
    ],
)
def test_only_equal_numbers_without_a_value_do_not_differ(
    ours: float, theirs: float, apart: float
) -> None:
    assert difference([1.0, ours], [1.0, theirs]) == apart


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_scenes_start_as_in_highway_env_with_its_own_mathematics(name: str) -> None:
    found = compare(name, range(20), decisions=0, tolerance=1e-9)
    assert found.differing == []
    assert found.largest_at_start <= 1e-9


def test_highway_env_computes_with_numpy_again_after_its_road_was_read() -> None:
    Episodes("merge-v0", 1)
    assert import_module("highway_env.road.lane").np is np
    assert import_module("highway_env.envs.merge_env").np is np
