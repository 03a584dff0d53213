"""What environments with one and with many learners return."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from charms_agents.training.completed_reward import CompletedReward, RewardScales
from charms_agents.training.rewards import StyleReward, Weights
from rows.case import Cases, Values, adding_to
from rows.hashing import Digests

from charms_bench.envs import ID
from charms_bench.envs.ego_env import ego_vector_env
from charms_bench.envs.highway_reward import HighwayReward
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.world.actions import ACTIONS

CASES: Cases = {}
case = adding_to(CASES)
FINAL = ("ending", "steps", "episode_return", "seed")
SMALL: dict[str, Any] = {"traffic_vehicles": 10, "density": 2.0, "duration_s": 10.0}


def episodes_in(env: Any, actions: Iterator[Any], episodes: int) -> Values:
    """Runs episodes of an environment; returns hashes of what it returns."""
    digests, endings = Digests(), []
    for seed in range(episodes):
        seen, info = env.reset(seed=seed)
        digests.add(observations=seen)
        is_over = False
        while not is_over:
            seen, reward, terminated, truncated, info = env.step(next(actions))
            digests.add(observations=seen, rewards=reward, ends=(terminated, truncated))
            if "action_mask" in info:
                digests.add(masks=info["action_mask"])
            is_over = terminated or truncated
        endings.append(info["ending"])
    return digests.values() | {"endings": endings}


def steps_in(env: Any, actions: Iterator[Any], steps: int) -> Values:
    """Runs steps of a vector environment; returns hashes of what it returns."""
    digests = Digests()
    seen, info = env.reset()
    digests.add(observations=seen)
    for _ in range(steps):
        seen, rewards, terminated, truncated, info = env.step(next(actions))
        digests.add(observations=seen, rewards=rewards, ends=(terminated, truncated))
        if "action_mask" in info:
            digests.add(masks=info["action_mask"])
        if "final_info" in info:
            final = info["final_info"]
            digests.add(**{name: final[name] for name in FINAL})
            last = [each for each in info["final_obs"] if each is not None]
            digests.add(final_obs=np.stack(last))
    return digests.values()


def controls(*shape: int) -> Iterator[Any]:
    """Yields random continuous actions, which steer little."""
    rng = np.random.default_rng(5)
    while True:
        yield (rng.uniform(-1, 1, (*shape, 2)) * [1.0, 0.05]).astype(np.float32)


def choices(*shape: int) -> Iterator[Any]:
    """Yields random meta-actions."""
    rng = np.random.default_rng(5)
    while True:
        chosen = rng.integers(len(ACTIONS), size=shape)
        yield chosen if shape else int(chosen)


for profile in ("charms", "highway-env", "naturalistic"):

    @case(f"one environment, continuous, {profile}")
    def continuous(folder: Path, profile: str = profile) -> Values:
        return episodes_in(
            gymnasium.make(ID, actions="continuous", profile=profile, **SMALL), controls(), 4
        )

    @case(f"one environment, meta, {profile}")
    def meta(folder: Path, profile: str = profile) -> Values:
        return episodes_in(gymnasium.make(ID, profile=profile, **SMALL), choices(), 4)

    @case(f"vector environment, continuous, {profile}")
    def many_continuous(folder: Path, profile: str = profile) -> Values:
        env = ego_vector_env(6, actions="continuous", profile=profile, first_seed=3, **SMALL)
        return steps_in(env, controls(6), 80)


OBSERVATIONS = {
    "neighbours": "neighbours",
    "neighbours with commands": {"type": "neighbours", "commands": True},
    "paper_neighbours": "paper_neighbours",
    "Kinematics": {"type": "Kinematics", "vehicles_count": 6, "see_behind": True,
                   "features": ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"]},
    "absolute Kinematics": {"type": "Kinematics", "absolute": True, "normalize": False},
}  # fmt: skip
for name, observation in OBSERVATIONS.items():

    @case(f"vector environment, meta, {name}")
    def observed(folder: Path, observation: Any = observation) -> Values:
        env = ego_vector_env(4, observation=observation, first_seed=3, **SMALL)
        return steps_in(env, choices(4), 60)


@case("learners as arrays")
def learners(folder: Path) -> Values:
    env = LearnersVectorEnv(3, traffic_vehicles=5, density=2.0, duration_s=8.0, first_seed=3)
    return steps_in(env, choices(env.num_envs), 60)


@case("some learners as arrays among PCH")
def some_learners(folder: Path) -> Values:
    env = LearnersVectorEnv(3, (0, 2, 3), "pch", first_seed=3, **SMALL)
    return steps_in(env, choices(env.num_envs), 60)


def parallel(env: Any, actions: int) -> Values:
    """Runs episodes of a PettingZoo environment; returns hashes of what it returns."""
    digests, rng, steps = Digests(), np.random.default_rng(2), 0
    for seed in range(3):
        seen, _ = env.reset(seed=seed)
        digests.add(observations=np.stack([*seen.values()]))
        while env.agents:
            agents = [*env.agents]
            seen, rewards, terminated, truncated, _ = env.step(
                {agent: int(rng.integers(actions)) for agent in agents}
            )
            digests.add(observations=np.stack([seen[agent] for agent in agents]))
            for agent in agents:
                ends = terminated[agent], truncated[agent]
                digests.add(rewards=rewards[agent], ends=ends)
            steps += 1
    return digests.values() | {"steps": steps}


@case("pettingzoo on the straight road")
def parallel_on_straight(folder: Path) -> Values:
    from charms_bench.envs.parallel_env import HighwayParallelEnv

    env = HighwayParallelEnv(traffic_vehicles=6, density=2.0, duration_s=8.0)
    return parallel(env, len(ACTIONS))


@case("pettingzoo on an intersection")
def parallel_on_road(folder: Path) -> Values:
    from charms_bench.envs.road_parallel_env import RoadParallelEnv

    return parallel(RoadParallelEnv("intersection-multi-agent-v1"), 3)


@case("rewards of highway-env beside the road")
def beside(folder: Path) -> Values:
    how: dict[str, Any] = {"reward": HighwayReward(), "profile": "highway-env", "first_seed": 3}
    env = ego_vector_env(6, actions="continuous", **how)
    steering = (each * [1.0, 2.0] for each in controls(6))
    return steps_in(env, (each.astype(np.float32) for each in steering), 60)


WEIGHTS = Weights(safety=0.8, efficiency=1.0, comfort=0.2)
REWARDS = {
    "styles": StyleReward(WEIGHTS, 0.75),
    "egoists": StyleReward(WEIGHTS, 0.0),
    "styles, completed": CompletedReward(WEIGHTS, 0.75, RewardScales()),
    "competitors, completed": CompletedReward(WEIGHTS, -0.75, RewardScales(others_gain_mps2=0.0)),
}
for name, reward in REWARDS.items():

    @case(f"rewards of {name}")
    def rewarded(folder: Path, reward: Any = reward) -> Values:
        env = ego_vector_env(8, reward=reward, first_seed=3, **SMALL)
        return steps_in(env, choices(8), 60)


@case("available actions on roads")
def available_actions(folder: Path) -> Values:
    digests, actions = Digests(), choices()
    for name in ("merge-v1", "exit-v1", "roundabout-v1", "two-way-v0", "u-turn-v1"):
        env: Any = gymnasium.make(f"charms_bench/{name}").unwrapped
        for seed in range(5):
            env.reset(seed=seed)
            is_over = False
            while not is_over:
                available = env.get_available_actions()
                digests.add(**{name: [each in available for each in range(len(ACTIONS))]})
                _, _, terminated, truncated, _ = env.step(next(actions))
                is_over = terminated or truncated
    return digests.values()
