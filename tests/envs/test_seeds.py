"""Seeds of vector environments mean what they mean in Gymnasium's and Stable-Baselines3's own."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from charms_bench.envs.ego_env import EgoEnv, ego_vector_env
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.envs.road_env import RoadEnv, RoadVectorEnv
from charms_bench.errors import InputError
from charms_bench.world.scene import EVALUATION_SEEDS

SHORT: dict[str, Any] = {"traffic_vehicles": 6, "duration_s": 2.0}
ROAD: dict[str, Any] = {"config": {"policy_frequency": 1}}
KINDS: dict[str, tuple[Callable[[], Any], Callable[[int], Any]]] = {
    "Ego-v0": (lambda: EgoEnv(**SHORT), lambda count: ego_vector_env(count, **SHORT)),
    "merge-v1": (
        lambda: RoadEnv("merge-v1", **ROAD),
        lambda count: RoadVectorEnv(count, "merge-v1", **ROAD),
    ),
}
SEVERAL: dict[str, Callable[[], Any]] = {
    **{name: lambda many=many: many(2) for name, (_, many) in KINDS.items()},
    "learners": lambda: LearnersVectorEnv(2, (0, 1), **SHORT),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_episodes_are_those_of_gymnasiums_vector_environment(kind: str) -> None:
    one, many = KINDS[kind]
    theirs, ours = SyncVectorEnv([one] * 3, autoreset_mode=AutoresetMode.SAME_STEP), many(3)
    ended = 0
    for seed in (5, None, [2**62, None, 4]):
        np.testing.assert_array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
        for _ in range(25):
            actions = ours.action_space.sample()
            found, expected = ours.step(actions)[:4], theirs.step(actions)[:4]
            for own, other in zip(found, expected, strict=True):
                np.testing.assert_allclose(own, other, rtol=0, atol=1e-6)
            ended += int((found[2] | found[3]).sum())
    assert ended > 12


@pytest.mark.parametrize("kind", KINDS)
def test_the_episodes_are_those_of_dummy_vec_env(kind: str) -> None:
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    from charms_bench.envs.sb3 import EpisodesVecEnv

    one, many = KINDS[kind]
    theirs, ours = vec_env.DummyVecEnv([one] * 3), EpisodesVecEnv(many(3))
    rng = np.random.default_rng(0)
    assert ours.seed(7) == theirs.seed(7) == [7, 8, 9]
    for _ in range(2):  # a seed counts once
        np.testing.assert_array_equal(ours.reset(), theirs.reset())
        for _ in range(25):
            actions = rng.integers(5, size=3)
            found, expected = ours.step(actions)[:3], theirs.step(actions)[:3]
            for own, other in zip(found, expected, strict=True):
                np.testing.assert_allclose(own, other, rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_of_an_algorithm_decides_its_weights(kind: str) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    from charms_bench.envs.sb3 import EpisodesVecEnv

    def learnt(seed: int) -> Any:
        env = EpisodesVecEnv(KINDS[kind][1](4))
        how = {"n_steps": 16, "batch_size": 32, "n_epochs": 1, "device": "cpu"}
        model = sb3.PPO("MlpPolicy", env, seed=seed, policy_kwargs={"net_arch": [8]}, **how)
        model.learn(128)
        seen = model.rollout_buffer.observations.copy()
        return seen, [each.detach().numpy() for each in model.policy.parameters()]

    (seen, weights), (same, again), (other, _) = (learnt(seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(seen, same)
    assert not np.array_equal(seen, other)
    for own, equal in zip(weights, again, strict=True):
        np.testing.assert_array_equal(own, equal)


@pytest.mark.parametrize("kind", SEVERAL)
def test_without_a_seed_no_two_environments_begin_alike(kind: str) -> None:
    one, other = (SEVERAL[kind]().reset()[0] for _ in range(2))
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("kind", SEVERAL)
def test_seeds_are_integers_of_any_kind_or_one_for_each(kind: str) -> None:
    env = SEVERAL[kind]()
    expected, _ = env.reset(seed=3)
    for seed in (np.int64(3), [3, 4], (3, np.uint8(4)), np.array([3, 4])):
        np.testing.assert_array_equal(env.reset(seed=seed)[0], expected)


@pytest.mark.parametrize("kind", SEVERAL)
@pytest.mark.parametrize(
    ("seed", "range_of_it"),
    [
        (-1, r"integer from 0 to 2\*\*64 - 1"),
        (2**64, r"integer from 0 to 2\*\*64 - 2"),
        (2**64 - 1, r"integer from 0 to 2\*\*64 - 2"),
        ([0, 2**64], r"integer from 0 to 2\*\*64 - 1"),
        (1.5, "expected an integer, or 2 seeds"),
        (True, "expected an integer, or 2 seeds"),
        ("34", "expected an integer, or 2 seeds"),
        ([1, 2, 3], "expected an integer, or 2 seeds"),
    ],
)
def test_a_seed_out_of_range_is_rejected_with_the_range(
    kind: str, seed: Any, range_of_it: str
) -> None:
    with pytest.raises(InputError, match=range_of_it):
        SEVERAL[kind]().reset(seed=seed)


def test_the_largest_seeds_have_episodes() -> None:
    many = ego_vector_env(2, **SHORT)
    many.reset(seed=2**64 - 2)
    assert many.simulation.seeds.tolist() == [2**64 - 2, 2**64 - 1]
    assert gymnasium.make("charms_bench/Ego-v0").reset(seed=2**64 - 1)[1]["seed"] == 2**64 - 1


def test_drawn_episodes_are_none_that_a_suite_evaluates() -> None:
    env = ego_vector_env(3, duration_s=1.0, traffic_vehicles=0, ego_slots=1)
    env.reset(seed=0)
    assert env.simulation.seeds.tolist() == [0, 1, 2]
    for _ in range(3):
        env.step([1, 1, 1])
    drawn = [int(np.random.default_rng(k).integers(2**62)) + EVALUATION_SEEDS for k in range(3)]
    assert env.simulation.seeds.tolist() == drawn


@pytest.mark.parametrize("make", [ego_vector_env, LearnersVectorEnv])
def test_seeds_count_on_from_the_first_one_where_it_is_given(make: Callable[..., Any]) -> None:
    env = make(2, first_seed=5, duration_s=1.0, traffic_vehicles=1, ego_slots=1)
    env.reset()
    found = env.simulation.seeds.tolist()
    for _ in range(3):
        env.step(np.ones(env.num_envs, dtype=np.int64))
    assert found + env.simulation.seeds.tolist() == [5, 6, 7, 8]
    with pytest.raises(InputError, match="seed -1; expected an integer"):
        make(2, first_seed=-1)


def test_a_seed_beside_a_state_decides_the_episodes_after_it() -> None:
    env, one = ego_vector_env(1, **SHORT), EgoEnv(**SHORT)
    env.reset(seed=1)
    state = env.get_state().scenes
    env.reset(seed=2, options={"state": state})
    one.reset(seed=2)
    for _ in range(6):
        env.step([1])
    assert env.simulation.seeds.tolist() == [one.reset()[1]["seed"]]


def test_a_saved_environment_draws_the_same_next_seeds() -> None:
    env, later = ego_vector_env(3, **SHORT), ego_vector_env(3, **SHORT)
    env.reset(seed=1)
    later.set_state(env.get_state())
    for each in (env, later):
        for _ in range(8):
            each.step([1, 1, 1])
    assert env.simulation.seeds.tolist() == later.simulation.seeds.tolist()
