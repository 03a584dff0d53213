"""Gymnasium's three modes in which the next episodes of a vector environment start."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import FlattenObservation, NormalizeObservation

from charms_bench.envs.ego_env import EgoEnv, ego_vector_env
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.envs.road_env import RoadEnv, RoadVectorEnv
from charms_bench.errors import InputError

SHORT: dict[str, Any] = {"traffic_vehicles": 6, "duration_s": 2.0, "density": 2.0}
MANY: dict[str, Any] = {"config": {"duration": 3}}
KINDS: dict[str, tuple[Callable[[], Any], Callable[[Any], Any]]] = {
    "Ego-v0": (
        lambda: EgoEnv(**SHORT),
        lambda mode: ego_vector_env(3, autoreset_mode=mode, **SHORT),
    ),
    "intersection-v0": (  # draws numbers in every step
        lambda: RoadEnv("intersection-v0", **MANY),
        lambda mode: RoadVectorEnv(3, "intersection-v0", autoreset_mode=mode, **MANY),
    ),
    "lane-keeping-v0": (  # draws noise in every observation
        lambda: RoadEnv("lane-keeping-v0"),
        lambda mode: RoadVectorEnv(3, "lane-keeping-v0", autoreset_mode=mode),
    ),
    "parking-v0": (
        lambda: RoadEnv("parking-v0", **MANY),
        lambda mode: RoadVectorEnv(3, "parking-v0", autoreset_mode=mode, **MANY),
    ),
}


def both(kind: str, mode: AutoresetMode) -> tuple[Any, Any]:
    one, many = KINDS[kind]
    return many(mode), SyncVectorEnv([one] * 3, autoreset_mode=mode)


def assert_close(found: Any, expected: Any) -> None:
    for own, other in zip(found, expected, strict=True):
        for name in own if isinstance(own, dict) else [...]:
            np.testing.assert_allclose(own[name], other[name], rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_episodes_start_as_in_gymnasiums_vector_environment(kind: str, mode: Any) -> None:
    ours, theirs = both(kind, mode)
    assert ours.metadata["autoreset_mode"] is mode
    assert_close(ours.reset(seed=2)[:1], theirs.reset(seed=2)[:1])
    ended = 0
    ours.action_space.seed(0)
    for _ in range(40):
        actions = ours.action_space.sample()
        found, expected = ours.step(actions), theirs.step(actions)
        assert_close(found[:4], expected[:4])
        for name in {"_speed", "_crashed", "_action_mask", "_final_obs"} & {*expected[4]}:
            np.testing.assert_array_equal(found[4][name], expected[4][name])
        ended += int((found[2] | found[3]).sum())
    assert ended > 3 or kind == "lane-keeping-v0"


@pytest.mark.parametrize("kind", KINDS)
def test_without_autoreset_the_caller_starts_the_episodes_that_have_ended(kind: str) -> None:
    ours, theirs = both(kind, AutoresetMode.DISABLED)
    assert_close(ours.reset(seed=2)[:1], theirs.reset(seed=2)[:1])
    ours.action_space.seed(0)
    for k in range(30):
        actions = ours.action_space.sample()
        found = ours.step(actions)
        assert_close(found[:4], theirs.step(actions)[:4])
        over = found[2] | found[3]
        if k % 7 == 6:
            over[0] = True
        if over.any():
            seed = [k, None, k + 1]
            options = {"reset_mask": over}
            started, infos = ours.reset(seed=seed, options=options)
            assert "reset_mask" in options
            expected, their_infos = theirs.reset(seed=seed, options={"reset_mask": over})
            assert_close([started], [expected])
            if "_speed" in their_infos:
                np.testing.assert_array_equal(infos["_speed"], their_infos["_speed"])


@pytest.mark.parametrize("kind", ["Ego-v0", "parking-v0"])
def test_an_ended_episode_is_not_stepped_without_autoreset(kind: str) -> None:
    env = KINDS[kind][1]("Disabled")
    env.reset(seed=2)
    over = np.zeros(3, dtype=np.bool_)
    while not over.any():
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        over = terminated | truncated
    ended = ", ".join(map(str, np.flatnonzero(over)))
    with pytest.raises(ResetNeeded, match=f"the episodes {ended} are over; .*reset_mask"):
        env.step(env.action_space.sample())


@pytest.mark.parametrize("name", ["Ego-v0", "merge-v1"])
def test_gymnasiums_wrappers_of_observations_take_it(name: str) -> None:
    mode = AutoresetMode.NEXT_STEP
    env = gymnasium.make_vec(f"charms_bench.envs:charms_bench/{name}", 2, autoreset_mode=mode)
    wrapped = NormalizeObservation(FlattenObservation(env))
    assert wrapped.reset(seed=0)[0].ndim == 2
    for _ in range(3):
        assert np.isfinite(wrapped.step(np.array([1, 1]))[0]).all()


def test_the_facts_about_an_ended_episode_are_infos_when_the_next_starts_later() -> None:
    env = ego_vector_env(2, autoreset_mode="NextStep", duration_s=1.0, traffic_vehicles=5)
    env.reset(seed=4)
    for _ in range(3):
        *_, infos = env.step([1, 1])
    assert infos["_steps"].all()
    assert infos["steps"].tolist() == [3, 3]
    assert infos["seed"].tolist() == [4, 5]
    *_, infos = env.step([1, 1])
    assert "steps" not in infos


def test_a_scene_of_learners_starts_in_the_step_after_its_last_has_left() -> None:
    env = LearnersVectorEnv(2, (0, 1), autoreset_mode="NextStep", duration_s=1.0)
    env.reset(seed=0)
    for _ in range(3):
        observations, _, _, truncations, _ = env.step([1] * 4)
    assert truncations.all()
    assert not env.alive.any()
    following, rewards, terminations, truncations, _ = env.step([1] * 4)
    assert env.alive.all()
    assert not np.any([rewards, terminations, truncations])
    assert (following != observations).any()


def test_masks_of_resets_are_checked() -> None:
    env = ego_vector_env(2)
    with pytest.raises(ResetNeeded, match="the first reset starts all"):
        env.reset(options={"reset_mask": np.array([True, False])})
    env.reset()
    for mask in ([True], [0, 1], [False, False], "ab"):
        with pytest.raises(InputError, match="option 'reset_mask'"):
            env.reset(options={"reset_mask": np.array(mask)})
    learners = LearnersVectorEnv(2, (0, 1))
    learners.reset()
    with pytest.raises(InputError, match="the learners of a scene start together"):
        learners.reset(options={"reset_mask": np.array([True, False, True, True])})
    before = learners.simulation.seeds.copy()
    learners.reset(options={"reset_mask": np.array([False, False, True, True])})
    assert (learners.simulation.seeds == before).tolist() == [True, False]


def test_an_unknown_mode_is_rejected_by_name() -> None:
    for make in KINDS.values():
        with pytest.raises(InputError, match="autoreset_mode: 'later'; expected one of 'NextStep'"):
            make[1]("later")
