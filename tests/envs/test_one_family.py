"""States, seeds and rewards are the same question in every kind of environment."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from test_copies import parallel

from charms_bench.envs.ego_env import EgoEnv, ego_vector_env
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.envs.road_env import RoadEnv, RoadVectorEnv
from charms_bench.errors import InputError

AGENTS = "intersection-multi-agent-v1"
SCENE: dict[str, Any] = {"traffic_vehicles": 6, "density": 2.0, "duration_s": 8.0}


MANY: dict[str, Callable[..., Any]] = {
    "learners": lambda **how: LearnersVectorEnv(2, (0, 2, 3), **SCENE, **how),
    "parallel": lambda **how: parallel("HighwayParallelEnv", **SCENE, **how),
    "parallel on a road": lambda **how: parallel("RoadParallelEnv", AGENTS, **how),
}
KINDS: dict[str, Callable[..., Any]] = {
    **MANY,
    "Ego-v0": EgoEnv,
    "vector of Ego-v0": partial(ego_vector_env, 2),
    "road": partial(RoadEnv, "merge-v1"),
    "vector of roads": partial(RoadVectorEnv, 2, "merge-v1"),
}


def step(env: Any, rng: np.random.Generator) -> Any:
    if hasattr(env, "possible_agents"):
        return env.step({agent: int(rng.integers(3)) for agent in env.agents})
    return env.step(rng.integers(3, size=env.num_envs))


@pytest.mark.parametrize("kind", KINDS)
def test_there_is_nothing_before_the_first_reset(kind: str) -> None:
    env = KINDS[kind](render_mode="rgb_array")
    early = [lambda: env.step(1), env.render, getattr(env, "action_masks", env.render)]
    for ask in early:
        with pytest.raises(ResetNeeded, match="before the first reset"):
            ask()


@pytest.mark.parametrize("kind", KINDS)
def test_a_mode_and_a_seed_that_there_are_not_are_rejected(kind: str) -> None:
    with pytest.raises(InputError, match=": no render_mode 'ansi'; expected 'rgb_array' or"):
        KINDS[kind](render_mode="ansi")
    env = KINDS[kind]()
    for seed in (-1, 2**64, 1.5, True, "3"):
        with pytest.raises(InputError, match="expected an integer"):
            env.reset(seed=seed)


@pytest.mark.parametrize("kind", MANY)
def test_episodes_of_many_learners_continue_from_a_saved_state(kind: str) -> None:
    env, other = MANY[kind](), MANY[kind]()
    env.reset(seed=4)
    for k in range(6):
        last = step(env, np.random.default_rng(k))
    state = env.get_state()
    expected = [step(env, np.random.default_rng(k)) for k in range(4)]
    seen = other.set_state(state)
    going = getattr(other, "agents", slice(None))
    kept = {agent: last[0][agent] for agent in going} if isinstance(going, list) else last[0]
    np.testing.assert_equal(seen, kept)
    np.testing.assert_equal([step(other, np.random.default_rng(k)) for k in range(4)], expected)
    with pytest.raises(InputError, match="found int, expected an"):
        other.set_state(5)


def test_seeds_of_roads_count_on_from_the_first() -> None:
    many, one = RoadVectorEnv(2, "merge-v1", first_seed=7), RoadEnv("merge-v1")
    seen = [*many.reset()[0]]
    while len(seen) < 4:
        observations, _, terminated, truncated, _ = many.step([3, 3])
        seen += [*observations[terminated | truncated]]
    for k, found in enumerate(seen):
        np.testing.assert_array_equal(found, one.reset(seed=7 + k)[0])
    many.reset(seed=3)
    assert many.get_state().next_seed is None


def test_rewards_of_ones_own_are_those_of_each_agent() -> None:
    def speeds(vehicles: Any, terms: Any) -> Any:
        return vehicles["speed"][:, :2]

    env, single = parallel("RoadParallelEnv", AGENTS, reward=speeds), RoadEnv(AGENTS, reward=speeds)
    env.reset(seed=1)
    single.reset(seed=1)
    many = RoadVectorEnv(1, AGENTS, reward=speeds)
    many.reset(seed=1)
    _, rewards, _, _, infos = env.step({"vehicle_0": 1, "vehicle_1": 2})
    expected = [infos[agent]["speed"] for agent in rewards]
    assert [*rewards.values()] == expected
    assert [*single.step((1, 2))[1]] == expected
    assert many.step((np.array([1]), np.array([2])))[1][0] == np.mean(expected)
    wrong = RoadEnv(AGENTS, reward=lambda vehicles, terms: vehicles["speed"][:, 0])
    wrong.reset(seed=0)
    with pytest.raises(InputError, match=r"found the shape \(1,\); expected \(1, 2\), one"):
        wrong.step((1, 1))
