"""The environments of highway-env's other roads, alone and as vectors."""

from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers its environments
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from PIL import ImageColor

import charms_bench.envs  # noqa: F401  # registers the environments
from charms_bench.envs.road_env import RoadEnv
from charms_bench.errors import InputError
from charms_bench.roads import TASKS
from charms_bench.world.picture import ASPHALT, EGO, FINE, HEADER, PLAN_M, WIDTH


def stock(name: str) -> Any:
    return gymnasium.spec(name).make(disable_env_checker=True)


def ours(name: str, **options: Any) -> Any:
    return gymnasium.spec(f"charms_bench/{name}").make(**options)


def vector(name: str, count: int, **options: Any) -> Any:
    spec = gymnasium.spec(f"charms_bench/{name}")
    return gymnasium.make_vec(spec, num_envs=count, **options)


@pytest.mark.parametrize("name", TASKS)
def test_spaces_and_default_configuration_are_those_of_highway_env(name: str) -> None:
    env, theirs = ours(name), stock(name)
    assert env.unwrapped.config == theirs.unwrapped.config
    assert env.observation_space == theirs.observation_space
    assert env.action_space == theirs.action_space


@pytest.mark.filterwarnings("ignore:.*is -?infinity")
def test_gymnasium_finds_nothing_wrong() -> None:
    check_env(ours("merge-v1", disable_env_checker=True).unwrapped, skip_render_check=True)


def test_a_step_returns_what_highway_env_returns() -> None:
    env, theirs = ours("exit-v1"), stock("exit-v1")
    for each in (env, theirs):
        each.reset(seed=3)
    observation, reward, terminated, truncated, info = env.step(2)
    expected = theirs.step(2)
    np.testing.assert_allclose(observation, expected[0], rtol=0, atol=1e-6)
    assert reward == pytest.approx(expected[1])
    assert (terminated, truncated) == expected[2:4]
    assert info.keys() == expected[4].keys()
    terms = expected[4]["rewards"]
    assert info["rewards"] == pytest.approx({name: float(terms[name]) for name in terms})
    assert info["is_success"] == expected[4]["is_success"]


def test_the_vector_environment_is_gymnasiums_of_highway_env() -> None:
    count, mode = 3, AutoresetMode.SAME_STEP
    theirs = SyncVectorEnv([lambda: stock("merge-v0")] * count, autoreset_mode=mode)
    env = vector("merge-v0", count)
    seen, expected = env.reset(seed=5)[0], theirs.reset(seed=5)[0]
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-6)
    rng, ended = np.random.default_rng(0), 0
    for _ in range(25):
        actions = rng.integers(5, size=count)
        found, expected = env.step(actions), theirs.step(actions)
        for one, other in zip(found[:4], expected[:4], strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-6)
        for row in np.nonzero(found[2] | found[3])[0]:
            ended += 1
            final, other = found[4]["final_obs"][row], expected[4]["final_obs"][row]
            np.testing.assert_allclose(final, other, rtol=0, atol=1e-6)
            speeds = [each[4]["final_info"]["speed"][row] for each in (found, expected)]
            assert speeds[0] == pytest.approx(speeds[1])
    assert ended >= count


def test_an_episode_of_the_two_way_road_has_at_most_15_decisions() -> None:
    slow = {"type": "DiscreteMetaAction", "target_speeds": [5, 10, 15]}
    env = vector("two-way-v0", 1, config={"action": slow})
    env.reset(seed=1)
    ends = [bool(env.step(np.array([4]))[3][0]) for _ in range(30)]
    assert [k for k, ended in enumerate(ends, 1) if ended] == [15, 30]


def test_reset_takes_a_configuration() -> None:
    env = ours("merge-generic-v0")
    env.reset(seed=0, options={"config": {"lanes_count": 4}})
    theirs = stock("merge-generic-v0")
    theirs.reset(seed=0, options={"config": {"lanes_count": 4}})
    found, expected = env.step(1)[0], theirs.step(1)[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["merge-v0", "roundabout-v0"])
def test_available_actions_are_those_of_highway_env(name: str) -> None:
    env, theirs = ours(name), stock(name)
    for seed in range(3):
        for each in (env, theirs):
            each.reset(seed=seed)
        for action in (2, 3, 0, 4):
            expected = theirs.unwrapped.get_available_actions()
            assert env.unwrapped.get_available_actions() == expected
            if theirs.step(action)[2] | env.step(action)[2]:
                break


@pytest.mark.parametrize(
    ("config", "what"),
    [
        ({"lanes": 3}, "no key named 'lanes'"),
        ({"action": {"type": "ContinuousAction"}}, "config.action.type: 'ContinuousAction'"),
        ({"observation": {"type": "GrayscaleObservation"}}, "'GrayscaleObservation'"),
        ({"observation": {"type": "Kinematics", "features": ["cos_d"]}}, "'cos_d'"),
        ({"observation": {"type": "Kinematics", "row": 3}}, "no key named 'row'"),
        ({"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"}, "LinearVehicle"),
        ({"manual_control": True}, "config.manual_control"),
    ],
)
def test_what_is_not_supported_is_rejected_by_name(config: dict[str, Any], what: str) -> None:
    with pytest.raises(InputError, match=what.replace(".", r"\.")):
        ours("merge-v0", config=config)


def test_a_wrong_action_is_rejected() -> None:
    env = vector("merge-v0", 2)
    env.reset(seed=0)
    with pytest.raises(InputError, match="action 5; expected 0 to 4"):
        env.step(np.array([0, 5]))
    with pytest.raises(InputError, match=r"expected integers of shape \(2,\)"):
        env.step(np.array([0.0, 1.0]))


@pytest.mark.parametrize("name", TASKS)
def test_the_ego_is_in_the_middle_of_the_picture_of_its_road(name: str) -> None:
    env = ours(name, render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    ego = np.argwhere((np.abs(frame.astype(int) - ImageColor.getrgb(EGO)) < 40).all(axis=2))
    road = (frame == ImageColor.getrgb(ASPHALT)).all(axis=2)
    in_view = ego[ego[:, 0] < 450]  # the legend has the colour, too
    middle = HEADER / FINE + PLAN_M[1] * WIDTH / FINE / PLAN_M[0] / 2, WIDTH / FINE / 2
    np.testing.assert_allclose(in_view.mean(axis=0), middle, atol=8)
    assert road.any()


def test_a_vector_environment_draws_every_scene() -> None:
    env = vector("roundabout-v0", 2, render_mode="rgb_array")
    env.reset(seed=0)
    first, second = env.render()
    assert first.shape == second.shape
    assert (first != second).any()


def test_an_unknown_render_mode_is_rejected_by_name() -> None:
    with pytest.raises(InputError, match="merge-v0: no render_mode 'ansi'; expected 'rgb_array'"):
        RoadEnv("merge-v0", render_mode="ansi")
