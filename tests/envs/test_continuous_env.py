"""`charms_bench/Ego-v0` with continuous actions, and the reward of progress along the road."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers highway-v0
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FlattenObservation

from charms_bench.envs import ID
from charms_bench.envs.ego_env import EgoEnv, ego_vector_env
from charms_bench.envs.highway_reward import HighwayReward
from charms_bench.envs.progress_reward import progress_reward
from charms_bench.errors import InputError
from charms_bench.world.profile import PROFILES

HIGHWAY = {"profile": "highway-env", "ego_slots": 1}
SHORT = {"duration_s": 2.0, "traffic_vehicles": 8}


def made(**arguments: Any) -> Any:
    return gymnasium.make(ID, actions="continuous", **arguments)


def returns(env: Any, action: Callable[[int], list[float]], steps: int) -> tuple[float, float]:
    """The sum of the rewards, and the distance driven along the road, m."""
    env.reset(seed=1)
    scene, total = env.unwrapped.simulation.scene, 0.0
    start = scene.x[0, 0]
    for step in range(steps):
        _, reward, terminated, truncated, _ = env.step(np.array(action(step), dtype=np.float32))
        total += reward
        assert not terminated
        assert not truncated
    return total, float(scene.x[0, 0] - start)


@pytest.mark.filterwarnings("ignore:.*A Box observation space m..imum value is -?infinity")
@pytest.mark.parametrize("profile", PROFILES)
def test_gymnasiums_checker_accepts_it(profile: str) -> None:
    check_env(made(profile=profile).unwrapped, skip_render_check=True)


def test_stable_baselines_checker_has_nothing_to_say() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(FlattenObservation(made()))


def test_the_action_space_is_that_of_highway_env() -> None:
    theirs = gymnasium.make("highway-v0", config={"action": {"type": "ContinuousAction"}})
    assert made().action_space == theirs.action_space
    assert ego_vector_env(3, actions="continuous").action_space.shape == (3, 2)


@pytest.mark.parametrize("profile", PROFILES)
def test_what_the_ego_sees_lies_in_the_space(profile: str) -> None:
    env = made(profile=profile, lanes=2, density=2.0, decision_hz=1)
    for seed in range(12):
        observation, _ = env.reset(seed=seed)
        rng, ended = np.random.default_rng(seed), False
        while not ended:
            assert observation in env.observation_space
            action = rng.uniform(-1, 1, 2).astype(np.float32) * [1, 0.1]
            observation, _, terminated, truncated, _ = env.step(action.astype(np.float32))
            ended = terminated or truncated
        assert observation in env.observation_space


def test_the_vector_environment_has_the_same_episodes() -> None:
    many = ego_vector_env(3, actions="continuous", **SHORT)
    one = made(**SHORT)
    many.reset(seed=4)
    one.reset(seed=6)
    for _ in range(5):
        actions = np.array([[0.1, 0.0], [-0.2, 0.01], [0.3, -0.01]], dtype=np.float32)
        seen, rewards, terminated, truncated, _ = many.step(actions)
        expected = one.step(actions[2])
        np.testing.assert_array_equal(seen[2], expected[0])
        assert (rewards[2], terminated[2], truncated[2]) == expected[1:4]


def test_a_state_continues_the_same() -> None:
    env = EgoEnv(actions="continuous", **SHORT)
    env.reset(seed=3)
    env.step(np.array([0.5, 0.01]))
    state = env.get_state()
    first = env.step(np.array([0.1, 0.0]))
    env.set_state(state)
    again = env.step(np.array([0.1, 0.0]))
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1:] == again[1:]


@pytest.mark.parametrize("density", [0.7, 2.0])
def test_episodes_observations_and_rewards_are_those_of_stock_highway(density: float) -> None:
    config = {
        "lanes_count": 3,
        "vehicles_count": 15,
        "vehicles_density": density,
        "duration": 8,
        "policy_frequency": 3,
        "action": {"type": "ContinuousAction"},
    }
    theirs = gymnasium.make("highway-v0", config=config)
    ours = made(
        **HIGHWAY,
        traffic_vehicles=15,
        density=density,
        duration_s=8.0,
        observation="Kinematics",
        reward=HighwayReward(),
    )
    for seed in range(4):
        compared = 0
        pairs = [(theirs.reset(seed=seed)[0], ours.reset(seed=seed)[0])]
        for action in controls(seed):
            expected, found = theirs.step(action), ours.step(action)
            pairs.append((expected[0], found[0]))
            assert found[1] == pytest.approx(expected[1], abs=1e-6)
            assert found[2:4] == expected[2:4]
            compared += 1
            if any(expected[2:4]):
                break
        for seen in pairs:
            np.testing.assert_allclose(*seen, rtol=0, atol=1e-6)
        assert compared > 2


def controls(seed: int) -> Iterator[Any]:
    rng = np.random.default_rng(seed)
    size = np.array([1.0, 10.0 ** -rng.integers(0, 4)])
    while True:
        yield (size * rng.uniform(-1, 1, 2)).astype(np.float32)


def test_driving_in_circles_earns_nothing() -> None:
    """At 25 m/s, the radius is 2.5 / sin(atan(tan(s) / 2)): 31.7 m for s = 0.2 * pi / 4."""
    env = made(**HIGHWAY, traffic_vehicles=0, lanes=8, duration_s=60.0)
    total, progress = returns(env, lambda step: [0.0, 0.2], 170)  # 7 circles
    assert abs(progress) < 70
    assert total <= 0
    stock = made(**HIGHWAY, traffic_vehicles=0, lanes=8, duration_s=60.0, reward=HighwayReward())
    assert returns(stock, lambda step: [0.0, 0.2], 170)[0] > 30


def test_driving_backwards_costs_what_driving_forwards_earns() -> None:
    env = made(**HIGHWAY, traffic_vehicles=0, duration_s=40.0)
    total, progress = returns(env, lambda step: [-1.0, 0.0], 100)
    assert progress < -500
    assert total == pytest.approx(progress / 10)  # 10 m in a decision interval of 1/3 s are worth 1


def test_a_vehicle_at_standstill_earns_nothing() -> None:
    env = made(**HIGHWAY, traffic_vehicles=0, duration_s=40.0)
    stops, progress = returns(env, lambda step: [-1.0 if step < 15 else 0.0, 0.0], 60)
    assert stops == pytest.approx(progress / 10)
    assert progress == pytest.approx(25**2 / 2 / 5, abs=1.0)


def test_driving_beside_the_road_earns_nothing() -> None:
    env = made(**HIGHWAY, traffic_vehicles=0, duration_s=40.0)
    env.reset(seed=1)
    rewards = [env.step(np.array([0.0, -0.05 if k < 3 else 0.0]))[1] for k in range(30)]
    assert rewards[0] == pytest.approx(25 / 30, abs=0.01)
    assert rewards[-1] == 0.0


def test_the_reward_of_handmade_decisions() -> None:
    found = progress_reward(
        progress_m=np.array([10.0, 5.0, 14.0, -5.0, 5.0, -5.0, 5.0]),
        interval_s=1 / 3,
        failed=np.array([False, False, False, False, False, False, True]),
        off_road=np.array([False, False, False, False, True, True, False]),
    )
    np.testing.assert_allclose(found, [1.0, 0.5, 1.0, -0.5, 0.0, -0.5, -0.5])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.array([np.nan, 0.0]), r"action \[nan  0.\]; expected numbers: acceleration, steering"),
        (np.array([0.0]), r"float64 of shape \(1, 1\); expected numbers of shape \(1, 2\)"),
        (3, "expected numbers"),
        ("left", "expected numbers"),
        ([0.0, [1.0]], "actions .*inhomogeneous"),
    ],
)
def test_a_wrong_action_is_named(action: Any, message: str) -> None:
    env = EgoEnv(actions="continuous", **SHORT)
    env.reset(seed=1)
    with pytest.raises(InputError, match=message):
        env.step(action)


def test_actions_are_clipped_as_in_highway_env() -> None:
    """Where it says nothing: its own environment clips -3 and 1.5, and infinity, to -1 and 1."""
    config = {"lanes_count": 3, "vehicles_count": 15, "action": {"type": "ContinuousAction"}}
    theirs = gymnasium.make("highway-v0", config=config)
    arguments = {**HIGHWAY, "traffic_vehicles": 15, "decision_hz": 1, "observation": "Kinematics"}
    ours = made(**arguments)
    theirs.reset(seed=1)
    ours.reset(seed=1)
    for action in ([-3.0, 0.001], [1.5, 0.0], [np.inf, -0.001]):
        given = np.array(action, dtype=np.float32)
        np.testing.assert_allclose(ours.step(given)[0], theirs.step(given)[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("given", [[0, 0], (0.0, 0.0), np.zeros(2, dtype=np.float32)])
def test_actions_may_be_lists_and_whole_numbers(given: Any) -> None:
    env, expected = EgoEnv(actions="continuous", **SHORT), None
    for action in (np.zeros(2), given):
        env.reset(seed=1)
        found = env.step(action)[0]
        expected = found if expected is None else expected
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("axis", "place"), [("longitudinal", 1), ("lateral", 0)])
def test_one_of_the_two_controls_can_be_left_out(axis: str, place: int) -> None:
    whole, part = EgoEnv(actions="continuous", **SHORT), None
    part = EgoEnv(actions="continuous", **{axis: False}, **SHORT)
    whole.reset(seed=1)
    part.reset(seed=1)
    action = np.zeros(2)
    action[place] = 0.02
    np.testing.assert_array_equal(part.step([0.02])[0], whole.step(action)[0])
    assert part.action_space.shape == (1,)


def test_a_wrong_kind_of_actions_is_named() -> None:
    for make in (EgoEnv, lambda **arguments: ego_vector_env(2, **arguments)):
        with pytest.raises(InputError, match="'discrete'; expected meta or continuous"):
            make(actions="discrete")


def test_a_network_with_continuous_actions_drives_the_traffic(
    network_file: Callable[..., Path],
) -> None:
    onnx = pytest.importorskip("onnx")
    path = network_file(np.zeros((35, 2)))
    model = onnx.load(path)
    onnx.helper.set_model_props(model, {"actions": "continuous"})
    onnx.save(model, path)
    many = ego_vector_env(2, traffic=str(path), **SHORT)
    many.reset(seed=1)
    speed = many.simulation.scene.speed.copy()
    many.step(np.ones(2, dtype=np.int64))
    others = np.arange(9) != many.simulation.scene.ego[:, None]
    assert (many.simulation.scene.speed == speed)[others].all()
