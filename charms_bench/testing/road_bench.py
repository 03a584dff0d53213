"""Measures an environment of `charms_bench.roads` beside highway-env, in turn and in one run."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import gymnasium

from charms_bench.envs.road_env import RoadVectorEnv
from charms_bench.testing.contestants import SEED, Step


@dataclass(frozen=True)
class Measurement:
    """The speed of one contestant on one thread, in decisions per second."""

    name: str
    environments: int
    decisions_per_s: float
    """Median over the rounds."""
    low: float
    high: float


def bench_road(
    name: str,
    seconds: float = 2.0,
    rounds: int = 3,
    progress: Callable[[str], None] = lambda name: None,
    environments: int = 100,
) -> list[Measurement]:
    """Measures a vector environment of so many `environments`, and one of highway-env.

    Actions are random, and observations and new episodes are included. For the other arguments,
    see `bench.bench`.
    """
    contestants = {
        f"charms_bench/{name}": (environments, _ours(name, environments)),
        "highway-env": (1, _highway_env(name)),
    }
    rates: dict[str, list[float]] = {each: [] for each in contestants}
    for _, step in contestants.values():
        step()  # compiles and allocates
    for _ in range(rounds):
        for each, (_, step) in contestants.items():
            progress(each)
            start, steps = time.perf_counter(), 0
            while not steps or time.perf_counter() < start + seconds:
                steps += step()
            rates[each].append(steps / (time.perf_counter() - start))
    return [
        Measurement(each, contestants[each][0], median(found), min(found), max(found))
        for each, found in rates.items()
    ]


def _ours(name: str, count: int) -> Step:
    env = RoadVectorEnv(count, name)
    env.reset(seed=SEED)
    env.action_space.seed(SEED)

    def step() -> int:
        env.step(env.action_space.sample())
        return count

    return step


def _highway_env(name: str) -> Step:
    import highway_env  # noqa: F401  # registers its environments

    env: Any = gymnasium.spec(name).make(disable_env_checker=True)
    env.reset(seed=SEED)
    env.action_space.seed(SEED)

    def step() -> int:
        truncated = env.step(env.action_space.sample())[3]
        if truncated or env.unwrapped._is_terminated():
            env.reset()
        return 1

    return step
