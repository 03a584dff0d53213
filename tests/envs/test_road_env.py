"""The environments of highway-env's other roads, alone and as vectors."""

import copy
import re
from collections.abc import Iterator
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers its environments
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
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


def test_agents_get_tuples_as_in_highway_env() -> None:
    env, theirs = ours("intersection-multi-agent-v1"), stock("intersection-multi-agent-v1")
    seen, expected = env.reset(seed=3)[0], theirs.reset(seed=3)[0]
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-6)
    for actions in ((1, 2), (0, 1), (2, 2)):
        assert [*env.unwrapped.get_available_actions()] == [
            *theirs.unwrapped.get_available_actions()
        ]
        seen, rewards, terminated, truncated, info = env.step(actions)
        expected, *others, their_info = theirs.step(actions)
        assert isinstance(seen, tuple)
        np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-6)
        assert rewards == pytest.approx(others[0])
        assert (terminated, truncated) == tuple(others[1:])
        assert info.keys() == their_info.keys()
        assert info["agents_rewards"] == pytest.approx(their_info["agents_rewards"])
        assert info["agents_terminated"] == their_info["agents_terminated"]


def test_the_vector_environment_has_means_of_the_agents_rewards() -> None:
    env, theirs = vector("intersection-multi-agent-v0", 2), stock("intersection-multi-agent-v0")
    env.reset(seed=5)
    theirs.reset(seed=6)
    seen, rewards, terminated, _, infos = env.step((np.array([0, 1]), np.array([2, 2])))
    expected, reward, is_over, _, info = theirs.step((1, 2))
    assert env.observation_space.contains(seen)
    np.testing.assert_allclose([each[1] for each in seen], expected, rtol=0, atol=1e-6)
    assert rewards[1] == pytest.approx(reward)
    assert terminated[1] == is_over
    assert tuple(infos["agents_rewards"][1]) == pytest.approx(info["agents_rewards"])


def test_highway_envs_own_idm_is_as_before() -> None:
    from highway_env.vehicle.behavior import IDMVehicle

    before = IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX, IDMVehicle.COMFORT_ACC_MIN
    ours("intersection-v0").reset(seed=0)
    after = IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX, IDMVehicle.COMFORT_ACC_MIN
    assert after == before


def test_another_number_of_actions_than_of_agents_is_rejected() -> None:
    env = ours("intersection-multi-agent-v0")
    env.reset(seed=0)
    with pytest.raises(InputError, match="actions of 3 agents; expected 2"):
        env.unwrapped.step((0, 1, 2))


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


GOAL = {"type": "KinematicsGoal", "scales": [1]}
ATTRIBUTES = {"type": "AttributesObservation"}
GRID = {"type": "OccupancyGrid"}
AGENTS = {"type": "MultiAgentAction"}
NOT_SUPPORTED: list[tuple[str, dict[str, Any], str]] = [
    ("intersection-v0", {"controlled_vehicles": 0}, "config.controlled_vehicles"),
    ("intersection-v0", {"simulation_frequency": 1}, "config.simulation_frequency"),
    ("intersection-v0", {"action": AGENTS | {"action": {}}}, "no key named 'action'"),
    ("intersection-v0", {"action": AGENTS | {"action_config": {"type": "A"}}}, "'A'"),
    ("merge-v0", {"lanes": 3}, "no key named 'lanes'"),
    ("merge-v0", {"observation": {"type": "GrayscaleObservation"}}, "'GrayscaleObservation'"),
    ("merge-v0", {"observation": {"type": "Kinematics", "features": ["lane"]}}, "'lane'"),
    ("merge-v0", {"observation": {"type": "Kinematics", "row": 3}}, "no key named 'row'"),
    ("merge-v0", {"other_vehicles_type": "highway_env.vehicle.kinematics.Vehicle"}, "DefensiveV"),
    ("merge-v0", {"manual_control": True}, "config.manual_control"),
    ("racetrack-oval-v0", {"action": {"type": "DiscreteMetaAction"}}, "expected 'ContinuousAction"),
    ("racetrack-oval-v0", {"observation": {"type": "TimeToCollision"}}, "'TimeToCollision'"),
    ("racetrack-oval-v0", {"observation": GRID | {"absolute": True}}, "observation.absolute"),
    ("racetrack-oval-v0", {"observation": GRID | {"features": ["lane"]}}, "'lane'"),
    ("racetrack-oval-v0", {"length": 0}, "config.length: 0"),
    ("racetrack-v0", {"observation": GOAL}, "'KinematicsGoal'"),
    ("lane-keeping-v0", {"action": {"type": "ContinuousAction"}}, "config.action.dynamical"),
    ("lane-keeping-v0", {"observation": ATTRIBUTES | {"attributes": ["lpv"]}}, "'lpv'"),
    ("parking-v0", {"observation": ATTRIBUTES}, "'AttributesObservation'"),
    ("parking-v0", {"observation": GOAL | {"features": ["heading"]}}, "'heading'"),
    ("parking-v0", {"observation": GOAL | {"features": ["x", "y"]}}, "observation.scales"),
    ("parking-v0", {"reward_weights": [1, 2]}, "highway-env does not start with it"),
    ("parking-v0", {"controlled_vehicles": 2}, "config.controlled_vehicles"),
]


@pytest.mark.parametrize(("name", "config", "what"), NOT_SUPPORTED)
def test_what_is_not_supported_is_rejected_by_name(
    name: str, config: dict[str, Any], what: str
) -> None:
    with pytest.raises(InputError, match=re.escape(what)):
        ours(name, config=config)


def test_goals_are_rewarded_as_in_highway_env() -> None:
    env, theirs = ours("parking-v0").unwrapped, stock("parking-v0").unwrapped
    rng = np.random.default_rng(0)
    achieved, desired = rng.normal(size=(2, 20, 6))
    found = env.compute_reward(achieved, desired, [{}] * 20)
    expected: Any = theirs.compute_reward(achieved, desired, [{}] * 20)
    np.testing.assert_allclose(found, expected)
    found, expected = (
        each.compute_reward(achieved[0], desired[0], {}, p=0.3) for each in (env, theirs)
    )
    assert found == pytest.approx(expected)
    # Stable-Baselines3 takes it for the sign of a goal.
    assert not hasattr(ours("merge-v0").unwrapped, "compute_reward")


def test_the_reward_of_a_step_is_that_of_its_goal() -> None:
    env = vector("parking-v0", 4)
    env.reset(seed=0)
    for _ in range(3):
        observations, rewards, *_, infos = env.step(np.zeros((4, 2), dtype=np.float32))
        achieved, desired = observations["achieved_goal"], observations["desired_goal"]
        np.testing.assert_array_equal(rewards, env.compute_reward(achieved, desired, {}))
    assert "rewards" not in infos


def test_the_vector_environment_of_a_car_park_is_gymnasiums_of_highway_env() -> None:
    count, mode = 2, AutoresetMode.SAME_STEP
    theirs = SyncVectorEnv([lambda: stock("parking-parked-v0")] * count, autoreset_mode=mode)
    env = vector("parking-parked-v0", count)
    env.reset(seed=3)
    theirs.reset(seed=3)
    ended, forward = 0, np.tile(np.array([1.0, 0.1], dtype=np.float32), (count, 1))
    while not ended:
        found, expected = env.step(forward), theirs.step(forward)
        for name, seen in expected[0].items():
            np.testing.assert_allclose(found[0][name], seen, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(found[2], expected[2])
        for row in np.nonzero(found[2])[0]:
            ended += 1
            final, other = found[4]["final_obs"][row], expected[4]["final_obs"][row]
            np.testing.assert_allclose(final["achieved_goal"], other["achieved_goal"], atol=1e-9)
            success = [each[4]["final_info"]["is_success"][row] for each in (found, expected)]
            assert success[0] == success[1]


def test_noise_is_drawn_in_the_order_of_highway_env() -> None:
    config = {"state_noise": 0.3, "derivative_noise": 0.01}
    env, theirs = ours("lane-keeping-v0", config=config), stock("lane-keeping-v0")
    theirs.unwrapped.configure(config)
    env.action_space.seed(0)
    for seed in (4, None):
        found, expected = (each.reset(seed=seed)[0] for each in (env, theirs))
        for _ in range(60):
            for name, seen in expected.items():
                np.testing.assert_allclose(found[name], seen, rtol=0, atol=1e-9)
            action = env.action_space.sample()
            found, reward, terminated, truncated, info = env.step(action)
            expected, *rest = theirs.step(action)
            assert reward == pytest.approx(rest[0])
            assert (terminated, truncated, info) == tuple(rest[1:])


def test_lane_keeping_ends_after_200_decisions() -> None:
    env = vector("lane-keeping-v0", 2)
    env.reset(seed=0)
    for _ in range(200):
        *_, truncated, infos = env.step(np.zeros((2, 1), dtype=np.float32))
    assert truncated.all()
    assert infos["final_info"] == {}
    assert "speed" in infos


def test_a_wrong_action_is_rejected() -> None:
    env = vector("merge-v0", 2)
    env.reset(seed=0)
    with pytest.raises(InputError, match="action 5; expected 0 to 4"):
        env.step(np.array([0, 5]))
    with pytest.raises(InputError, match=r"expected integers of shape \(2,\)"):
        env.step(np.array([0.0, 1.0]))
    env = vector("racetrack-v0", 2)
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"expected numbers of shape \(2, 1\)"):
        env.step(np.array([0.0, 1.0]))
    with pytest.raises(InputError, match="not all of them are finite"):
        env.step(np.array([[0.0], [np.nan]]))
    with pytest.raises(InputError, match="expected meta-actions"):
        ours("racetrack-v0").unwrapped.get_available_actions()


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


def test_a_change_of_the_configuration_counts_from_the_next_reset_on() -> None:
    changed, given = ours("merge-v0"), ours("merge-v0", config={"policy_frequency": 3})
    changed.reset(seed=0)
    changed.unwrapped.config["policy_frequency"] = 3
    for env in (changed, given):
        env.reset(seed=1)
    np.testing.assert_array_equal(changed.step(3)[0], given.step(3)[0])


def test_a_wrong_change_of_the_configuration_is_rejected_at_the_next_reset() -> None:
    env = ours("merge-v0").unwrapped
    env.configure({"lanes": 3})
    with pytest.raises(InputError, match="merge-v0: config: no key named 'lanes'"):
        env.reset()


def same(one: Any, other: Any) -> bool:
    """Whether observations, arrays or tuples or dictionaries of them, are equal."""
    if isinstance(one, tuple):
        return all(map(same, one, other))
    if isinstance(one, dict):
        return all(same(each, other[name]) for name, each in one.items())
    return np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("name", ["merge-v1", "intersection-multi-agent-v2", "lane-keeping-v0"])
def test_episodes_continue_from_a_saved_state(name: str) -> None:
    one, many = ours(name).unwrapped, vector(name, 3)
    for env in (one, many):
        env.action_space.seed(0)
        env.reset(seed=5)
        actions = [env.action_space.sample() for _ in range(12)]
        for action in actions[:4]:
            last = env.step(action)[0]
        state = env.get_state()
        first = copy.deepcopy([env.step(action)[:4] for action in actions[4:]])
        assert same(env.set_state(state), last)
        for action, expected in zip(actions[4:], first, strict=True):
            assert same(env.step(action)[:4], expected)
    with pytest.raises(InputError, match=f"^{name}: set_state: the state is of 3 episodes of"):
        one.set_state(many.get_state())
    with pytest.raises(ResetNeeded):
        ours(name).unwrapped.get_state()


def test_masks_of_actions_are_highway_envs_available_actions() -> None:
    env, many = ours("exit-v1").unwrapped, vector("exit-v1", 2)
    for each in (env, many):
        each.reset(seed=0)
    for action in (1, 4, 4):
        assert not env.step(action)[2]
        many.step([action, 1])
        assert [*np.nonzero(env.action_masks())[0]] == sorted(env.get_available_actions())
        assert np.array_equal(many.action_masks()[0], env.action_masks())
    racetrack = ours("racetrack-v0").unwrapped
    racetrack.reset(seed=0)
    with pytest.raises(InputError, match="racetrack-v0: action masks: expected meta-actions"):
        racetrack.action_masks()


def test_a_reward_of_ones_own_replaces_highway_envs() -> None:
    def hurried(vehicles: Any, terms: Any) -> Any:
        return vehicles["speed"][:, 0] - 5 * terms["lane_change_reward"]

    env, many = ours("merge-v1", reward=hurried), vector("merge-v1", 2, reward=hurried)
    env.reset(seed=0)
    many.reset(seed=0)
    for action in (1, 0, 3):
        reward, info = env.step(action)[1::3]
        assert reward == info["speed"] - 5 * (action == 0)
        assert many.step([action, 1])[1][0] == reward
    wrong = ours("merge-v1", reward=lambda vehicles, terms: vehicles["speed"])
    wrong.reset(seed=0)
    with pytest.raises(InputError, match=r"merge-v1: reward: found the shape \(1, 6\); expected"):
        wrong.step(1)


def test_a_rejected_configuration_leaves_the_environment_as_it_was() -> None:
    env = RoadEnv("highway-fast-v0")
    expected, _ = env.reset(seed=0)
    for wrong in ({"lanes_cont": 3}, {"lanes_count": 0}):
        with pytest.raises(InputError, match="highway-fast-v0: config"):
            env.reset(seed=5, options={"config": wrong})
    assert np.array_equal(env.reset(seed=0)[0], expected)


def test_a_lane_may_be_counted_from_the_right_as_in_highway_env() -> None:
    action = {"type": "DiscreteMetaAction", "target_speeds": np.linspace(20, 30, 5)}
    config = {"initial_lane_id": -1, "action": action}
    stock: Any = gymnasium.make("highway-fast-v0", config=config)
    ours = RoadEnv("highway-fast-v0", config)
    assert np.array_equal(ours.reset(seed=1)[0], stock.reset(seed=1)[0])
    assert ours.vehicle.lane_index == stock.unwrapped.vehicle.lane_index


@pytest.mark.parametrize(
    ("config", "what"),
    [
        ("x", "config: 'x'; expected a dictionary"),
        ({1: 2}, "config: no key named '1'"),
        ({"observation": None}, "config.observation: None; expected a dictionary"),
        ({"action": "meta"}, "config.action: 'meta'; expected a dictionary"),
        ({"collision_reward": "bad"}, "config.collision_reward: 'bad'; expected a number"),
        ({"duration": float("nan")}, "config.duration: nan; expected a number"),
        ({"vehicles_count": -3}, "config.vehicles_count: -3; expected at least 0"),
        ({"simulation_frequency": 0}, "config.simulation_frequency: 0; expected more than 0"),
        (
            {"policy_frequency": 30},
            "config.policy_frequency: 30; expected more than 0, and at most",
        ),
        (
            {"observation": {"type": "OccupancyGrid", "grid_step": [0, 0]}},
            "config.observation: not all values can be used",
        ),
    ],
)
def test_a_value_of_the_wrong_kind_is_rejected_by_name(config: Any, what: str) -> None:
    with pytest.raises(InputError, match=f"^highway-v0: {what}"):
        RoadEnv("highway-v0", config)


def leaves(info: Any) -> Iterator[Any]:
    """What an info is made of."""
    parts = info.values() if isinstance(info, dict) else info
    for each in parts:
        yield from leaves(each) if isinstance(each, dict | tuple) else (each,)


@pytest.mark.parametrize("name", TASKS)
def test_infos_are_made_of_pythons_own_numbers(name: str) -> None:
    """As in highway-env; wrappers such as `NumpyToTorch` know no other truth values."""
    env: Any = ours(name).unwrapped
    _, info = env.reset(seed=0)
    action = env.action_space.sample()
    given = [*leaves(action)] if isinstance(action, tuple) else [action]
    *_, later = env.step(action)
    for each in (*leaves(info), *leaves(later)):
        assert type(each) in (int, float, bool) or any(each is one for one in given)


def test_an_action_beyond_the_range_is_clipped_unless_the_configuration_says_otherwise() -> None:
    for clip, expected in ((True, 1.0), (False, 1.5)):
        config = {"action": {"type": "ContinuousAction", "longitudinal": False, "clip": clip}}
        env = ours("racetrack-v1", config=config)
        theirs = gymnasium.make("racetrack-v1", config=config)
        for each in (env, theirs):
            each.reset(seed=0)
            each.step(np.array([1.5], dtype=np.float32))
        own = env.unwrapped.vehicle.action["steering"]
        assert own == theirs.unwrapped.vehicle.action["steering"]
        assert own == pytest.approx(expected * np.pi / 4, rel=1e-6)
        if clip:
            env.step(np.array([np.inf], dtype=np.float32))
        else:
            with pytest.raises(InputError, match="not all of them are finite"):
                env.step(np.array([np.inf], dtype=np.float32))


def test_lists_and_tensors_are_actions() -> None:
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    many = vector("merge-v1", 2)
    pair: Any = RoadEnv("intersection-multi-agent-v0")
    for as_given in (list, torch.tensor):
        many.reset(seed=0)
        *_, infos = many.step(as_given([0, 3]))
        assert infos["action"].tolist() == [0, 3]
        pair.reset(seed=0)
        pair.step(as_given([1, 1]))
    with pytest.raises(InputError, match="expected those of several agents"):
        pair.step(1)


def test_a_vehicle_of_the_moment_cannot_be_changed() -> None:
    env = RoadEnv("merge-v1")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="read-only"):
        env.vehicle.position[0] = 300.0
