"""Trains an algorithm of Stable-Baselines3 on one of highway-env's roads, and evaluates it.

The algorithm learns in the vector environment, or in environments of highway-env itself. In both
cases, what it has learnt drives the same 200 episodes here, which equal highway-env's.

    python tools/train_on_roads.py merge
    python tools/train_on_roads.py merge --simulator highway-env
    python tools/train_on_roads.py merge --steps 0  # random actions
"""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from stable_baselines3 import DQN, PPO, SAC, HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

import charms_bench.envs  # noqa: F401  # registers the environments
from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.roads.episodes import Episodes
from charms_bench.testing.stock_roads import unchanged_idm

EPISODES, FIRST_SEED = 200, 1_000_000
"""Of the evaluation."""
SIMULATORS = ("charms-bench", "highway-env")


class Training(NamedTuple):
    """What learns where."""

    road: str
    algorithm: Any
    steps: tuple[int, int]
    """The decisions in each of `SIMULATORS`, in a few CPU minutes."""
    environments: tuple[int, int]
    """How many of them are side by side in each of `SIMULATORS`."""
    settings: dict[str, Any]
    """What differs from the defaults of Stable-Baselines3."""
    steps_per_update: int = 0
    """Decisions per gradient step; 0 for PPO, which has other settings."""
    config: dict[str, Any] | None = None
    """What differs from highway-env's configuration of the road."""


_DQN = {"learning_rate": 5e-4, "learning_starts": 1_000, "buffer_size": 100_000, "gamma": 0.8}
_DQN |= {"batch_size": 64, "target_update_interval": 250, "exploration_fraction": 0.3}
_SAC = {"learning_rate": 1e-3, "learning_starts": 2_000, "gamma": 0.95, "tau": 0.05}
TRAININGS = {
    "merge": Training("merge-v1", DQN, (100_000, 20_000), (100, 4), _DQN, 4),
    "roundabout": Training("roundabout-v1", DQN, (100_000, 5_000), (100, 4), _DQN, 4),
    "parking": Training(
        "parking-v0",
        SAC,
        (80_000, 20_000),
        (20, 2),
        {**_SAC, "replay_buffer_class": HerReplayBuffer, "policy_kwargs": {"net_arch": [128, 128]}},
        2,
        {"add_walls": False, "duration": 20},
    ),
    "racetrack": Training(
        "racetrack-v1",
        SAC,
        (40_000, 10_000),
        (40, 4),
        {**_SAC, "policy_kwargs": {"net_arch": [64, 64]}},
        4,
    ),
    "intersection": Training(
        "intersection-v2",
        PPO,
        (200_000, 3_200),
        (100, 20),
        {"n_steps": 32, "batch_size": 640, "gamma": 0.9},
    ),
}


def environments(training: Training, simulator: str, seed: int) -> VecEnv:
    """The environments in which the algorithm learns."""
    if simulator == "charms-bench":
        name, count = f"charms_bench/{training.road}", training.environments[0]
        return EpisodesVecEnv(gymnasium.make_vec(name, num_envs=count, config=training.config))
    given = {"config": training.config}
    return make_vec_env(training.road, training.environments[1], seed=seed, env_kwargs=given)


def learn(training: Training, simulator: str, steps: int, seed: int) -> tuple[Any, float]:
    """The model after `decisions` decisions, and the CPU time that they took, s."""
    episodes, settings = environments(training, simulator, seed), dict(training.settings)
    if training.steps_per_update:
        updates = episodes.num_envs // training.steps_per_update
        settings |= {"train_freq": 1, "gradient_steps": max(updates, 1)}
    policy = "MultiInputPolicy" if training.road.startswith("parking") else "MlpPolicy"
    model = training.algorithm(policy, episodes, seed=seed, device="cpu", **settings)
    began = time.process_time()
    model.learn(steps, log_interval=None)
    return model, time.process_time() - began


def evaluate(training: Training, choose: Callable[[Any], Any]) -> dict[str, float]:
    """The mean return, and how many episodes end with a crash and with the goal reached."""
    road, episodes = training.road, Episodes(training.road, EPISODES, training.config)
    episodes.seed(episodes.everyone, np.arange(EPISODES, dtype=np.uint64) + FIRST_SEED)
    episodes.start(episodes.everyone)
    seen: Any = episodes.observe()
    returns, goal = np.zeros(EPISODES), np.zeros(EPISODES, dtype=np.bool_)
    crashed, running = goal.copy(), ~goal
    while running.any():
        lanes_before = episodes.scenes.vehicles["lane"][:, 0].copy()
        decision = episodes.step(choose(seen))
        seen, has_crashed = decision.observations, episodes.scenes.vehicles["crashed"][:, 0]
        returns += np.where(running, decision.rewards, 0.0)
        if road.startswith("racetrack"):
            reached = decision.truncated  # it is still on the track
        elif road.startswith("roundabout"):
            reached = episodes.task.has_reached_goal(episodes.scenes, lanes_before)
        else:
            reached = decision.terminated
        ended = running & (decision.terminated | decision.truncated)
        crashed |= ended & has_crashed
        goal |= ended & reached & ~has_crashed
        running &= ~ended
    return {
        "mean_return": float(returns.mean()),
        "crashed_percent": 100 * float(crashed.mean()),
        "goal_percent": 100 * float(goal.mean()),
    }


def main() -> None:
    """Trains, evaluates and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("kind", choices=TRAININGS)
    parser.add_argument("--simulator", choices=SIMULATORS, default=SIMULATORS[0])
    parser.add_argument("--steps", type=int, help="decisions; with 0, actions are random")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    training = TRAININGS[given.kind]
    default = training.steps[SIMULATORS.index(given.simulator)]
    steps = default if given.steps is None else given.steps
    if steps:
        with unchanged_idm():
            model, cpu_s = learn(training, given.simulator, steps, given.seed)
        steps = model.num_timesteps
        found = evaluate(training, lambda seen: model.predict(seen, deterministic=True)[0])
    else:
        space, cpu_s = Episodes(training.road, 1).actions.space, 0.0
        space.seed(given.seed)
        found = evaluate(training, lambda _: np.array([space.sample() for _ in range(EPISODES)]))
    made = {"kind": given.kind, "simulator": given.simulator, "steps": steps}
    rounded = {name: round(each, 2) for name, each in ({"cpu_minutes": cpu_s / 60} | found).items()}
    print(json.dumps(made | rounded))


if __name__ == "__main__":
    main()
