"""Configurations of highway-env's environments: a few chosen ones, and random values of keys."""

from typing import Any

import numpy as np

Config = dict[str, Any]
CHOSEN: dict[str, list[Config]] = {
    "highway-fast-v0": [
        {"initial_lane_id": 1, "normalize_reward": False, "offroad_terminal": True}
    ],
    "merge-generic-v0": [{"lanes_count": 3, "vehicles_count": 8, "converge_merge_length": 60}],
    "exit-v0": [{"lanes_count": 4, "vehicles_count": 12, "vehicles_density": 1.2}],
    "u-turn-v1": [{"normalize_reward": False, "policy_frequency": 3, "duration": 5}],
    "roundabout-generic-v1": [
        {"roundabout_radius": 30, "roundabout_lanes": 3, "vehicles_count": 9}
    ],
    "two-way-v0": [{"observation": {"type": "Kinematics", "see_behind": True, "clip": False}}],
    "roundabout-v0": [{"action": {"type": "DiscreteMetaAction", "lateral": False}}],
    "racetrack-v0": [{"action": {"type": "ContinuousAction", "dynamical": True}}],
    "racetrack-v1": [{"action": {"type": "DiscreteAction", "actions_per_axis": 5}}],
    "racetrack-oval-v0": [
        {
            "observation": {
                "type": "OccupancyGrid",
                "features": ["vx", "on_road", "presence", "sin_h", "x"],
                "features_range": {"x": [-20, 30], "vx": [-10, 10]},
                "as_image": True,
            },
            "block_lane": True,
            "force_decision": True,
            "other_vehicles": 12,
        }
    ],
    "parking-v0": [
        {
            "action": {"type": "ContinuousAction", "dynamical": True},
            "observation": {
                "type": "KinematicsGoal",
                "features": ["cos_h", "presence", "vy"],
                "scales": [2, 1, 7.5],
            },
        }
    ],
    "parking-parked-v0": [{"vehicles_count": 40, "add_walls": False}],
    "lane-keeping-v0": [
        {
            "observation": {
                "type": "AttributesObservation",
                "attributes": ["derivative", "reference_state", "state", "derivative"],
            },
            "state_noise": 0.4,
            "policy_frequency": 3,
        }
    ],
    "racetrack-large-v1": [
        {
            "observation": {"type": "Kinematics", "features": ["x", "y", "cos_h"]},
            "speed_limit": 14,
            "terminate_off_road": False,
            "collision_reward": -0.3,
        }
    ],
    "intersection-multi-agent-v2": [
        {
            "action": {
                "type": "MultiAgentAction",
                "action_config": {"type": "DiscreteAction", "actions_per_axis": 3},
            }
        }
    ],
}
LINEAR = [
    {"other_vehicles_type": f"highway_env.vehicle.behavior.{kind}Vehicle"}
    for kind in ("Linear", "Aggressive", "Defensive")
]
FEATURES = ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"]
OF_ROUTES = ["cos_d", "sin_d", "long_off", "lat_off", "ang_off"]


def configurations(name: str, count: int) -> list[Config]:
    """The configurations of an environment: chosen ones, those of linear vehicles, random ones."""
    found: list[Config] = [*CHOSEN.get(name, [])]
    if not name.startswith(("parking", "lane-keeping")):
        found += LINEAR
    return found + [random_configuration(name, seed) for seed in range(count - len(found))]


def random_configuration(name: str, seed: int) -> Config:
    """Values for the keys that an environment of that name documents."""
    rng = np.random.default_rng([seed, sum(map(ord, name))])
    speeds = sorted(map(float, rng.choice(np.arange(0, 40, 2), rng.integers(2, 5), replace=False)))
    axes = {"longitudinal": True, "lateral": bool(rng.random() < 0.7)}
    config: Config = {
        "policy_frequency": int(rng.integers(1, 6)),
        "simulation_frequency": int(rng.integers(5, 21)),
        "collision_reward": float(-rng.random()),
        "neighbour_vehicles_connected_lanes": bool(rng.random() < 0.5),
    }
    if name.startswith("racetrack"):
        return config | _racetrack(name, rng)
    if name.startswith("parking"):
        return config | _parking(rng)
    if name.startswith("lane-keeping"):
        rates = ("simulation_frequency", "policy_frequency")
        return {key: config[key] for key in rates} | _lane_keeping(rng)
    if rng.random() < 0.2:
        config |= LINEAR[rng.integers(3)]
    if name.startswith("intersection"):
        return config | _intersection("multi-agent" in name, rng)
    config["high_speed_reward"] = float(rng.random())
    config["action"] = {"type": "DiscreteMetaAction", "target_speeds": speeds, **axes}
    if rng.random() < 0.7:
        config["observation"] = _kinematics(rng)
    else:
        config["observation"] = {"type": "TimeToCollision", "horizon": int(rng.integers(3, 12))}
    return config | _motorway_or_junction(name.rpartition("-")[0], rng)


def _motorway_or_junction(kind: str, rng: np.random.Generator) -> Config:
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
    own: dict[str, Config] = {
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
    return own[kind]


def _kinematics(rng: np.random.Generator) -> Config:
    flags = ("absolute", "normalize", "clip", "see_behind", "include_obstacles")
    return {
        "type": "Kinematics",
        "features": FEATURES[: rng.integers(3, 9)],
        "vehicles_count": int(rng.integers(2, 10)),
        **{flag: bool(rng.random() < 0.5) for flag in flags},
    }


def _controls(rng: np.random.Generator) -> Config:
    """Actions that are accelerations and steering angles."""
    axes = [(True, True), (False, True), (True, False)][rng.choice(3, p=[0.5, 0.4, 0.1])]
    action: Config = {
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


def _racetrack(name: str, rng: np.random.Generator) -> Config:
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
        "action": _controls(rng),
        "observation": grid if rng.random() < 0.8 else _kinematics(rng),
        "other_vehicles": int(rng.integers(0, 9)),
        "lane_centering_cost": float(rng.uniform(1, 8)),
        "lane_centering_reward": float(rng.uniform(0, 2)),
        "action_reward": float(-rng.random()),
        "speed_limit": float(rng.uniform(6, 15)),
        "terminate_off_road": bool(rng.random() < 0.5),
        "duration": int(rng.integers(5, 30)),
        **(oval if "oval" in name else {}),
    }


def _parking(rng: np.random.Generator) -> Config:
    names = [name for name in FEATURES if name != "heading"]
    names = rng.permutation(names)[: rng.integers(1, 7)].tolist()
    scales = [float(scale) for scale in rng.uniform(0.5, 50, len(names))]
    kinds: list[Config] = [
        {"type": "KinematicsGoal", "features": names, "scales": scales},
        _kinematics(rng),
    ]
    return {
        "action": _controls(rng)
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


def _lane_keeping(rng: np.random.Generator) -> Config:
    names = rng.choice(["state", "derivative", "reference_state"], rng.integers(1, 5)).tolist()
    attributes = {"type": "AttributesObservation", "attributes": names}
    return {
        "action": _controls(rng) | {"dynamical": True},
        "observation": attributes if rng.random() < 0.8 else _kinematics(rng),
        "state_noise": float(rng.uniform(0, 0.5)),
        "derivative_noise": float(rng.uniform(0, 0.5)),
    }


def _intersection(has_agents: bool, rng: np.random.Generator) -> Config:
    lateral = bool(rng.random() < 0.3)
    speeds = np.sort(rng.choice(np.arange(0.0, 15.0), rng.integers(2, 5), replace=False))
    action: Config = {
        "type": "DiscreteMetaAction",
        "longitudinal": bool(not lateral or rng.random() < 0.7),
        "lateral": lateral,
        "target_speeds": speeds.tolist(),
    }
    if rng.random() < 0.2:
        range_ = [-0.5, 0.6]
        is_dynamical = bool(rng.random() < 0.5)
        action = {
            "type": "ContinuousAction",
            "steering_range": range_,
            "dynamical": is_dynamical,
        }
    observation = _at_an_intersection(rng, action)
    if has_agents:
        action = {"type": "MultiAgentAction", "action_config": action}
        observation = {"type": "MultiAgentObservation", "observation_config": observation}
    destination = [None, "o0", "o1", "o2", "o3"][rng.integers(5)]
    return {
        "action": action,
        "observation": observation,
        "duration": int(rng.integers(3, 25)),
        "destination": destination,
        "controlled_vehicles": int(rng.integers(1, 6)),
        "initial_vehicle_count": int(rng.integers(0, 25)),
        "spawn_probability": float(rng.random()),
        "high_speed_reward": float(rng.random()),
        "arrived_reward": float(rng.random()),
        "reward_speed_range": [float(rng.uniform(0, 5)), float(rng.uniform(6, 10))],
        "normalize_reward": bool(rng.random() < 0.5),
        "offroad_terminal": bool(rng.random() < 0.3),
    }


def _at_an_intersection(rng: np.random.Generator, action: Config) -> Config:
    if rng.random() < 0.2 and action["type"] == "DiscreteMetaAction":
        return {"type": "TimeToCollision", "horizon": int(rng.integers(3, 12))}
    names = rng.permutation([*FEATURES, *OF_ROUTES])[: rng.integers(1, 14)].tolist()
    if rng.random() < 0.2:
        return {"type": "OccupancyGrid", "features": [*names, "on_road"]}
    ranges = {"x": [-80, 90], "vy": [-10, 20], "cos_d": [0, 1], "ang_off": [-2, 3]}
    flags = ("absolute", "normalize", "clip", "see_behind", "observe_intentions")
    return {
        "type": "Kinematics",
        "features": names,
        "features_range": ranges if rng.random() < 0.5 else None,
        "vehicles_count": int(rng.integers(2, 12)),
        "order": "sorted" if rng.random() < 0.7 else "as_they_come",
        **{flag: bool(rng.random() < 0.5) for flag in flags},
    }
