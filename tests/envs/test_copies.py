"""A copy of an environment, made in whatever way, continues like its original."""

import copy
import pickle
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest

from charms_bench.envs.ego_env import EgoEnv, ego_vector_env
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.envs.road_env import RoadEnv, RoadVectorEnv

SHORT: dict[str, Any] = {"traffic_vehicles": 8, "duration_s": 4.0, "density": 1.5}
DRAWN: dict[str, Any] = {**SHORT, "render_mode": "rgb_array"}
MAKERS: dict[str, Callable[[], Any]] = {
    "Ego": lambda: EgoEnv(**DRAWN),
    "Ego, mixed": lambda: EgoEnv(traffic={"idm_mobil_varied": 0.5, "stackelberg": 0.5}, **DRAWN),
    "Ego, planner": lambda: EgoEnv(traffic="mpc", traffic_vehicles=1, ego_slots=1),
    "Ego, inflow": lambda: EgoEnv(
        inflow={"vehicles_per_hour_and_lane": 1500, "capacity": 20}, **DRAWN
    ),
    "Ego, continuous": lambda: EgoEnv(actions="continuous", **DRAWN),
    "Ego, vector": lambda: ego_vector_env(3, **DRAWN),
    "Ego, next step": lambda: ego_vector_env(3, autoreset_mode="NextStep", **DRAWN),
    "learners": lambda: LearnersVectorEnv(2, (0, 3), **DRAWN),
    "parallel": lambda: parallel("HighwayParallelEnv", **DRAWN),
    "road": lambda: RoadEnv("merge-v1", render_mode="rgb_array"),
    "road, noise": lambda: RoadEnv("lane-keeping-v0"),
    "road, vector": lambda: RoadVectorEnv(2, "intersection-v0", render_mode="rgb_array"),
    "road, parallel": lambda: parallel("RoadParallelEnv", "intersection-multi-agent-v1"),
    "VecEnv": lambda: vec_env(ego_vector_env(3, **DRAWN)),
    "wrapped": lambda: gymnasium.make("charms_bench.envs:charms_bench/Ego-v0", **DRAWN),
}


def parallel(kind: str, *given: Any, **others: Any) -> Any:
    pytest.importorskip("pettingzoo", reason="needs the extra 'pettingzoo'")
    from charms_bench.envs import parallel_env, road_parallel_env

    return {**vars(parallel_env), **vars(road_parallel_env)}[kind](*given, **others)


def vec_env(episodes: Any) -> Any:
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    from charms_bench.envs.sb3 import EpisodesVecEnv

    return EpisodesVecEnv(episodes)


def by_attributes(env: Any) -> Any:
    """As highway-env copies its environments, and with nothing in common between attributes."""
    made = object.__new__(type(env))
    for name, value in vars(env).items():
        vars(made)[name] = copy.deepcopy(value)
    return made


def by_cloudpickle(env: Any) -> Any:
    cloudpickle = pytest.importorskip("cloudpickle")
    return pickle.loads(cloudpickle.dumps(env))


COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "attributes": by_attributes,
    "cloudpickle": by_cloudpickle,
    **{
        f"protocol {k}": lambda env, k=k: pickle.loads(pickle.dumps(env, protocol=k))
        for k in (0, 5)
    },
}


def start(env: Any, seed: int) -> None:
    if hasattr(env, "seed"):  # a VecEnv
        env.seed(seed)
        env.reset()
    else:
        env.reset(seed=seed)


def steps(env: Any, count: int, seed: int) -> list[Any]:
    """The results of random actions, and what the environment starts after an ending."""
    rng, results = np.random.default_rng(seed), []
    for _ in range(count):
        if hasattr(env, "possible_agents"):
            action: Any = {agent: int(rng.integers(3)) for agent in env.agents}
            result = env.step(action) if env.agents else env.reset()
        else:
            space = env.action_space
            space.seed(int(rng.integers(1000)))
            each = getattr(env, "num_envs", 1)
            is_vec = hasattr(env, "step_wait")
            action = np.array([space.sample() for _ in range(each)]) if is_vec else space.sample()
            result = env.step(action)
            if isinstance(env, gymnasium.Env) and (result[2] or result[3]):
                results.append(plain(result))
                result = env.reset()
        results.append(plain(result))
    return results


def plain(thing: Any) -> Any:
    """The same with lists instead of arrays, which can be compared."""
    if isinstance(thing, np.ndarray | np.generic):
        return plain(thing.tolist())
    if isinstance(thing, dict):
        return {name: plain(value) for name, value in thing.items()}
    return [plain(each) for each in thing] if isinstance(thing, list | tuple) else thing


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("how", COPIES)
def test_a_copy_continues_like_its_original(name: str, how: str) -> None:
    env = MAKERS[name]()
    many = how == "deepcopy" and name not in ("Ego, planner", "road, vector")
    for seed in range(20 if many else 2):
        start(env, seed)
        steps(env, 2, seed)
        first, later = COPIES[how](env), COPIES[how](env)
        found = steps(first, 8, seed)
        expected = steps(env, 8, seed)
        np.testing.assert_equal(found, expected)
        np.testing.assert_equal(steps(later, 8, seed), expected)


@pytest.mark.parametrize("name", ["Ego", "Ego, vector", "learners", "parallel", "road", "VecEnv"])
@pytest.mark.parametrize("how", ["deepcopy", "attributes", "protocol 5"])
def test_the_picture_of_a_copy_is_its_own(name: str, how: str) -> None:
    env = MAKERS[name]()
    start(env, 3)
    other = COPIES[how](env)
    before = np.array(env.render())
    steps(env, 3, 0)
    np.testing.assert_array_equal(other.render(), before)
    steps(other, 3, 0)
    np.testing.assert_array_equal(other.render(), env.render())


def arrays_in(thing: Any, path: str, seen: set[int]) -> Iterator[tuple[str, np.ndarray]]:
    """All arrays that can be reached, by where they were first found."""
    if isinstance(thing, np.ndarray):
        yield path, thing
        return
    if id(thing) in seen:
        return
    seen.add(id(thing))
    parts = dict(enumerate(thing)) if isinstance(thing, tuple | list) else {}
    parts |= thing if isinstance(thing, dict) else getattr(thing, "__dict__", {})
    for name, part in parts.items():
        yield from arrays_in(part, f"{path}.{name}", seen)


def shared(env: Any) -> set[frozenset[str]]:
    """The paths of arrays that share memory."""
    groups = defaultdict(set)
    for path, array in arrays_in(env, "", set()):
        owner = array
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        if array.size:
            groups[owner.ctypes.data].add(path)
    return {frozenset(group) for group in groups.values() if len(group) > 1}


@pytest.mark.parametrize("how", ["deepcopy", "protocol 0", "protocol 5"])
@pytest.mark.parametrize("name", ["Ego", "Ego, continuous", "Ego, vector", "learners", "road"])
def test_arrays_of_a_copy_share_memory_where_those_of_the_original_do(name: str, how: str) -> None:
    env = MAKERS[name]()
    start(env, 0)
    steps(env, 1, 0)
    other = COPIES[how](env)
    steps(other, 1, 0)
    assert shared(other) == shared(env)
    if name != "road":
        assert len(shared(env)) > 20  # what plugins see are views of the scene
