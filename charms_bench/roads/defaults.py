"""highway-env's default configurations, and how its environments are registered, by their names."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from charms_bench.world.named_road import FILE_ROAD

Config = Mapping[str, Any]
_COMMON: dict[str, Any] = {
    "observation": {"type": "Kinematics"},
    "action": {"type": "DiscreteMetaAction"},
    "simulation_frequency": 15,
    "policy_frequency": 1,
    "other_vehicles_type": "highway_env.vehicle.behavior.IDMVehicle",
    "screen_width": 600,
    "screen_height": 150,
    "centering_position": [0.3, 0.5],
    "scaling": 5.5,
    "show_trajectories": False,
    "render_agent": True,
    "offscreen_rendering": None,
    "manual_control": False,
    "real_time_rendering": False,
    "neighbour_vehicles_connected_lanes": False,
}
"""[`AbstractEnv.default_config`]"""
_HIGHWAY = _COMMON | {
    "lanes_count": 4,
    "vehicles_count": 50,
    "controlled_vehicles": 1,
    "initial_lane_id": None,
    "duration": 40,
    "ego_spacing": 2,
    "vehicles_density": 1,
    "collision_reward": -1,
    "right_lane_reward": 0.1,
    "high_speed_reward": 0.4,
    "lane_change_reward": 0,
    "reward_speed_range": [20, 30],
    "normalize_reward": True,
    "offroad_terminal": False,
}
_HIGHWAY_FAST = _HIGHWAY | {
    "simulation_frequency": 5,
    "lanes_count": 3,
    "vehicles_count": 20,
    "duration": 30,
    "ego_spacing": 1.5,
}
_EXIT = _HIGHWAY | {
    "observation": {
        "type": "ExitObservation",
        "vehicles_count": 15,
        "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h"],
        "clip": False,
    },
    "action": {"type": "DiscreteMetaAction", "target_speeds": [18, 24, 30]},
    "lanes_count": 6,
    "collision_reward": 0,
    "high_speed_reward": 0.1,
    "right_lane_reward": 0,
    "goal_reward": 1,
    "vehicles_count": 20,
    "vehicles_density": 1.5,
    "duration": 18,
    "simulation_frequency": 5,
    "scaling": 5,
}
_MERGE = _COMMON | {
    "collision_reward": -1,
    "right_lane_reward": 0.1,
    "high_speed_reward": 0.2,
    "reward_speed_range": [20, 30],
    "merging_speed_reward": -0.5,
    "lane_change_reward": -0.05,
}
_MERGE_GENERIC = _MERGE | {
    "lanes_count": 2,
    "vehicles_count": 3,
    "before_merge_length": 150,
    "converge_merge_length": 80,
    "parallel_merge_length": 80,
    "after_merge_length": 150,
}
_TWO_WAY = _COMMON | {
    "observation": {"type": "TimeToCollision", "horizon": 5},
    "collision_reward": 0,
    "left_lane_constraint": 1,
    "left_lane_reward": 0.2,
    "high_speed_reward": 0.8,
}
_U_TURN = _COMMON | {
    "observation": {"type": "TimeToCollision", "horizon": 16},
    "action": {"type": "DiscreteMetaAction", "target_speeds": [8, 16, 24]},
    "screen_width": 789,
    "screen_height": 289,
    "duration": 10,
    "collision_reward": -1.0,
    "left_lane_reward": 0.1,
    "high_speed_reward": 0.4,
    "reward_speed_range": [8, 24],
    "normalize_reward": True,
    "offroad_terminal": False,
}
_ROUNDABOUT = _COMMON | {
    "observation": {
        "type": "Kinematics",
        "absolute": True,
        "features_range": {"x": [-100, 100], "y": [-100, 100], "vx": [-15, 15], "vy": [-15, 15]},
    },
    "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 8, 16]},
    "incoming_vehicle_destination": None,
    "collision_reward": -1,
    "high_speed_reward": 0.2,
    "right_lane_reward": 0,
    "lane_change_reward": -0.05,
    "screen_height": 600,
    "centering_position": [0.5, 0.6],
    "duration": 11,
    "normalize_reward": True,
}
_ROUNDABOUT_GENERIC = _ROUNDABOUT | {
    "roundabout_radius": 20,
    "roundabout_lanes": 2,
    "vehicles_count": 5,
    "duration": 17,
}
_RACETRACK = _COMMON | {
    "observation": {
        "type": "OccupancyGrid",
        "features": ["presence", "on_road"],
        "grid_size": [[-18, 18], [-18, 18]],
        "grid_step": [3, 3],
        "as_image": False,
        "align_to_vehicle_axes": True,
    },
    "action": {
        "type": "ContinuousAction",
        "longitudinal": False,
        "lateral": True,
        "target_speeds": [0, 5, 10],
    },
    "policy_frequency": 5,
    "duration": 300,
    "collision_reward": -1,
    "lane_centering_cost": 4,
    "lane_centering_reward": 1,
    "action_reward": -0.3,
    "controlled_vehicles": 1,
    "other_vehicles": 1,
    "screen_height": 600,
    "centering_position": [0.5, 0.5],
    "speed_limit": 10.0,
    "terminate_off_road": True,
}
_RACETRACK_OVAL = _RACETRACK | {
    "length": 100,
    "no_lanes": 3,
    "block_lane": False,
    "force_decision": False,
}
_PARKING = _COMMON | {
    "observation": {
        "type": "KinematicsGoal",
        "features": ["x", "y", "vx", "vy", "cos_h", "sin_h"],
        "scales": [100, 100, 5, 5, 1, 1],
        "normalize": False,
    },
    "action": {"type": "ContinuousAction"},
    "reward_weights": [1, 0.3, 0, 0, 0.02, 0.02],
    "success_goal_reward": 0.12,
    "collision_reward": -5,
    "steering_range": math.radians(45),
    "policy_frequency": 5,
    "duration": 100,
    "screen_height": 300,
    "centering_position": [0.5, 0.5],
    "scaling": 7,
    "controlled_vehicles": 1,
    "vehicles_count": 0,
    "add_walls": True,
}
_LANE_KEEPING = _COMMON | {
    "observation": {
        "type": "AttributesObservation",
        "attributes": ["state", "derivative", "reference_state"],
    },
    "action": {
        "type": "ContinuousAction",
        "steering_range": [-math.pi / 3, math.pi / 3],
        "longitudinal": False,
        "lateral": True,
        "dynamical": True,
    },
    "simulation_frequency": 10,
    "policy_frequency": 10,
    "state_noise": 0.05,
    "derivative_noise": 0.05,
    "screen_height": 250,
    "scaling": 7,
    "centering_position": [0.4, 0.5],
}
_AT_INTERSECTION: dict[str, Any] = {
    "type": "Kinematics",
    "vehicles_count": 15,
    "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h"],
    "features_range": {"x": [-100, 100], "y": [-100, 100], "vx": [-20, 20], "vy": [-20, 20]},
    "absolute": True,
    "flatten": False,
    "observe_intentions": False,
}
_INTERSECTION = _COMMON | {
    "observation": _AT_INTERSECTION,
    "action": {
        "type": "DiscreteMetaAction",
        "longitudinal": True,
        "lateral": False,
        "target_speeds": [0, 4.5, 9],
    },
    "duration": 13,
    "destination": "o1",
    "controlled_vehicles": 1,
    "initial_vehicle_count": 10,
    "spawn_probability": 0.6,
    "screen_height": 600,
    "centering_position": [0.5, 0.6],
    "scaling": 5.5 * 1.3,
    "collision_reward": -5,
    "high_speed_reward": 1,
    "arrived_reward": 1,
    "reward_speed_range": [7.0, 9.0],
    "normalize_reward": False,
    "offroad_terminal": False,
}
_INTERSECTION_CONTINUOUS = _INTERSECTION | {
    "observation": _AT_INTERSECTION
    | {
        "vehicles_count": 5,
        "features": ["presence", "x", "y", "vx", "vy", "long_off", "lat_off", "ang_off"],
    },
    "action": {
        "type": "ContinuousAction",
        "steering_range": [-math.pi / 3, math.pi / 3],
        "longitudinal": True,
        "lateral": True,
        "dynamical": True,
        "target_speeds": [0, 4.5, 9],
    },
}
_INTERSECTION_MULTI_AGENT = _INTERSECTION | {
    "action": {
        "type": "MultiAgentAction",
        "action_config": {
            "type": "DiscreteMetaAction",
            "lateral": False,
            "longitudinal": True,
            "target_speeds": [0, 4.5, 9],
        },
    },
    "observation": {"type": "MultiAgentObservation", "observation_config": _AT_INTERSECTION},
    "controlled_vehicles": 2,
}
_CONNECTED = {"neighbour_vehicles_connected_lanes": True}
"""[`ConnectedLaneNeighboursMixin.default_config`]"""
_FILE_ROAD = _COMMON | {
    "file": "",
    "sha256": "",
    "density": 10,
    "start": "drawn",
    "controlled_vehicles": 1,
    "duration": 40,
    "policy_frequency": 5,
    **_CONNECTED,
}
"""A road in a file, with so many vehicles per km of lane; not an environment of highway-env."""
_VERSIONS = {
    "merge": _MERGE,
    "merge-generic": _MERGE_GENERIC,
    "exit": _EXIT,
    "u-turn": _U_TURN,
    "roundabout": _ROUNDABOUT,
    "roundabout-generic": _ROUNDABOUT_GENERIC,
    "racetrack": _RACETRACK,
    "racetrack-large": _RACETRACK,
    "racetrack-oval": _RACETRACK_OVAL,
}
"""The environments with a version `-v1` that connects lanes."""
DEFAULTS: Mapping[str, Config] = MappingProxyType(
    {
        "highway-v0": _HIGHWAY,
        "highway-fast-v0": _HIGHWAY_FAST,
        "two-way-v0": _TWO_WAY,
        **{f"{name}-v0": config for name, config in _VERSIONS.items()},
        **{f"{name}-v1": config | _CONNECTED for name, config in _VERSIONS.items()},
        "parking-v0": _PARKING,
        "parking-ActionRepeat-v0": _PARKING | {"policy_frequency": 1, "duration": 20},
        "parking-parked-v0": _PARKING | {"vehicles_count": 10},
        "lane-keeping-v0": _LANE_KEEPING,
        "intersection-v0": _INTERSECTION,
        "intersection-v1": _INTERSECTION_CONTINUOUS,
        "intersection-v2": _INTERSECTION | _CONNECTED,
        "intersection-multi-agent-v0": _INTERSECTION_MULTI_AGENT,
        "intersection-multi-agent-v1": _INTERSECTION_MULTI_AGENT,
        "intersection-multi-agent-v2": _INTERSECTION_MULTI_AGENT | _CONNECTED,
        FILE_ROAD: _FILE_ROAD,
    }
)
"""The default configuration of each environment [`default_config`]."""
MOST_STEPS: Mapping[str, int] = MappingProxyType({"two-way-v0": 15, "lane-keeping-v0": 200})
"""The decisions after which episodes are truncated, where they are [`max_episode_steps`]."""
SPLIT = ("intersection-multi-agent-v1", "intersection-multi-agent-v2")
"""The environments in which each agent has its own reward and ending [`MultiAgentWrapper`]."""


UNLIMITED_S = 45.0
"""Default duration of an episode, s, on the roads on which highway-env truncates none: enough for a
slow ego to reach the goal."""


def duration_of(road: Any) -> float:
    """Default duration of an episode on a road, given as in a suite, s [`duration`]."""
    name = str(road.get("name", "")) if isinstance(road, Mapping) else str(road)
    if isinstance(road, Mapping) and "file" in road:
        name = FILE_ROAD
    config = DEFAULTS.get(name, {})
    if name in MOST_STEPS:
        return float(MOST_STEPS[name] / config["policy_frequency"])
    return float(config.get("duration", UNLIMITED_S))
