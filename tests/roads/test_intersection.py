"""highway-env's intersection: other configurations, and what no other road has."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from charms_bench.roads.episodes import Episodes
from charms_bench.roads.kinematics import FEATURES
from charms_bench.roads.scenes import IDM, NOTHING
from charms_bench.testing.road_parity import Comparison, verify_configurations

SLOWER, IDLE = 0, 1


def random_action(rng: np.random.Generator) -> dict[str, Any]:
    if rng.random() < 0.15:
        return {
            "type": "ContinuousAction",
            "steering_range": [-0.5, 0.6],
            "dynamical": bool(rng.random() < 0.5),
        }
    speeds = np.sort(rng.choice(np.arange(0.0, 15.0), rng.integers(2, 5), replace=False))
    lateral = bool(rng.random() < 0.3)
    return {
        "type": "DiscreteMetaAction",
        "longitudinal": bool(not lateral or rng.random() < 0.7),
        "lateral": lateral,
        "target_speeds": speeds.tolist(),
    }


def random_observation(rng: np.random.Generator, action: dict[str, Any]) -> dict[str, Any]:
    if rng.random() < 0.2 and action["type"] == "DiscreteMetaAction":
        return {"type": "TimeToCollision", "horizon": int(rng.integers(3, 12))}
    names = rng.permutation(FEATURES)[: rng.integers(1, 14)].tolist()
    if rng.random() < 0.2:
        return {"type": "OccupancyGrid", "features": [*names, "on_road"]}
    flags = ("absolute", "normalize", "clip", "see_behind", "observe_intentions")
    return {
        "type": "Kinematics",
        "features": names,
        "features_range": {"x": [-80, 90], "vy": [-10, 20], "cos_d": [0, 1], "ang_off": [-2, 3]}
        if rng.random() < 0.5
        else None,
        "vehicles_count": int(rng.integers(2, 12)),
        "order": "sorted" if rng.random() < 0.7 else "as_they_come",
        **{flag: bool(rng.random() < 0.5) for flag in flags},
    }


def random_configuration(seed: int, agents: bool) -> dict[str, Any]:
    """Values for the keys that `intersection` documents."""
    rng = np.random.default_rng(seed)
    action = random_action(rng)
    observation = random_observation(rng, action)
    if agents:
        action = {"type": "MultiAgentAction", "action_config": action}
        observation = {"type": "MultiAgentObservation", "observation_config": observation}
    return {
        "action": action,
        "observation": observation,
        "policy_frequency": int(rng.integers(1, 6)),
        "simulation_frequency": int(rng.integers(5, 21)),
        "duration": int(rng.integers(3, 25)),
        "destination": rng.choice([None, "o0", "o1", "o2", "o3"]),
        "controlled_vehicles": int(rng.integers(1, 6)),
        "initial_vehicle_count": int(rng.integers(0, 25)),
        "spawn_probability": float(rng.random()),
        "collision_reward": float(-rng.random()),
        "high_speed_reward": float(rng.random()),
        "arrived_reward": float(rng.random()),
        "reward_speed_range": [float(rng.uniform(0, 5)), float(rng.uniform(6, 10))],
        "normalize_reward": bool(rng.random() < 0.5),
        "offroad_terminal": bool(rng.random() < 0.3),
        "neighbour_vehicles_connected_lanes": bool(rng.random() < 0.5),
    }


AGENTS = {False: "intersection-v0", True: "intersection-multi-agent-v0"}
"""The environments with one agent and with several."""


@pytest.mark.slow
@pytest.mark.parametrize("agents", AGENTS)
def test_100_random_configurations_give_the_episodes_of_highway_env(agents: bool) -> None:
    configs = [random_configuration(seed, agents) for seed in range(100)]
    assert verify_configurations(AGENTS[agents], configs, workers=1).differing == []


@pytest.mark.slow
def test_agents_may_have_discrete_accelerations_and_steering_angles(
    compared: Callable[..., Comparison],
) -> None:
    action = {"type": "DiscreteAction", "actions_per_axis": 3}
    config = {"action": {"type": "MultiAgentAction", "action_config": action}}
    assert compared("intersection-multi-agent-v2", range(1), config=config).differing == []


def started(count: int, **config: Any) -> Episodes:
    episodes = Episodes("intersection-v0", count, config)
    episodes.seed(episodes.everyone, np.arange(count, dtype=np.uint64))
    episodes.start(episodes.everyone)
    return episodes


def present(episodes: Episodes) -> Any:
    """Whether there is a vehicle at each place (B, N)."""
    return episodes.scenes.vehicles["kind"] != NOTHING


def test_vehicles_enter_and_leave_while_the_ego_waits() -> None:
    episodes = started(20, duration=60)
    has_entered = has_left = False
    for _ in range(40):
        before = present(episodes)
        episodes.step(np.full(20, SLOWER))
        after = present(episodes)
        has_entered |= bool((after & ~before).any())
        has_left |= bool((before & ~after).any())
        order = episodes.scenes.order["place"]
        assert (np.sort(order, axis=1) == np.arange(order.shape[1])).all()
        in_order = np.take_along_axis(after, order, axis=1)
        assert (np.diff(in_order.astype(int), axis=1) <= 0).all()  # those with nothing are last
    assert has_entered
    assert has_left


def test_no_vehicle_enters_with_probability_0() -> None:
    episodes = started(20, spawn_probability=-1.0)
    for _ in range(12):
        before = present(episodes)
        episodes.step(np.full(20, IDLE))
        assert not (present(episodes) & ~before).any()


def test_only_idm_vehicles_yield_and_they_want_to_stand() -> None:
    episodes, count = started(50), 0
    for _ in range(10):
        episodes.step(np.full(50, IDLE))
        yielding = episodes.scenes.vehicles[episodes.scenes.vehicles["is_yielding"]]
        yielding = yielding[yielding["kind"] != NOTHING]
        count += yielding.size
        assert (yielding["kind"] == IDM).all()
        assert (yielding["target_speed"] == 0).all()
    assert count > 10


def test_the_scene_has_room_for_the_vehicles_of_a_long_episode() -> None:
    episodes = started(10, duration=300, spawn_probability=1.0)
    for _ in range(300):
        episodes.step(np.full(10, SLOWER))
    assert present(episodes).sum(axis=1).max() < episodes.scenes.vehicles.shape[1]
