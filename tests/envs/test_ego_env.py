"""`charms_bench/Ego-v0`: accepted by the checkers, and the same episodes as a run's."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers highway-v0
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FlattenObservation

from charms_bench.engine.endings import ENDINGS, RUNNING
from charms_bench.engine.simulation import Simulation
from charms_bench.envs import ID
from charms_bench.envs.ego_env import EgoEnv, ego_vector_env
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.errors import InputError, RegistryError
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.world.actions import ACTIONS, FASTER, IDLE, LANE_LEFT, LANE_RIGHT, SLOWER
from charms_bench.world.observations import neighbours
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import EVALUATION_SEEDS, Floats, SceneSettings

SHORT = {"duration_s": 2.0, "traffic_vehicles": 8}


CUT_IN = {
    "scenario": {
        "parameters": {"gap_m": [5, 50], "closing_mps": [2, 6]},
        "ego": {"lane": 1, "speed_mps": 28.0},
        "vehicles": [
            {
                "name": "cutter",
                "lane": 0,
                "ahead_of": "ego",
                "gap_m": "gap_m",
                "speed_mps": "28 - closing_mps",
                "actions": [{"at_s": 0.5, "lane": 1, "duration_s": 3.0}],
            },
            {
                "name": "behind",
                "lane": 1,
                "behind": "ego",
                "gap_m": 40,
                "speed_mps": 28.0,
                "agent": "idm_mobil",
            },
        ],
    }
}


class Forward:
    """The ego's speed, m/s."""

    def prepare(self, simulation: Simulation, actions: Any) -> None:
        pass

    def __call__(self, simulation: Simulation, prepared: None) -> Floats:
        return simulation.scene.speed[simulation.ego_vehicles]


def made(**arguments: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(ID, **arguments)


def until_over(env: Any, seed: int, actions: Iterator[Any]) -> list[tuple[Any, ...]]:
    observation, _ = env.reset(seed=seed)
    steps: list[tuple[Any, ...]] = [(observation,)]
    while len(steps) == 1 or not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(next(actions)))
    return steps


def whims(seed: int) -> Iterator[np.int64]:
    rng = np.random.default_rng(seed)
    while True:
        yield rng.integers(5)


@pytest.mark.parametrize("profile", PROFILES)
def test_gymnasiums_checker_has_nothing_to_say(profile: str) -> None:
    check_env(made(profile=profile).unwrapped, skip_render_check=True)


def test_stable_baselines_checker_has_nothing_to_say_but_that_it_likes_flat_observations() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(FlattenObservation(made()))
    with pytest.warns(UserWarning, match="unconventional shape") as said:
        checker.check_env(made())
    assert len(said) == 1


def test_stable_baselines_own_helper_makes_some() -> None:
    helper = pytest.importorskip("stable_baselines3.common.env_util")
    some = helper.make_vec_env(ID, 2, seed=0, env_kwargs=SHORT)
    assert some.reset().shape == (2, 7, 5)


@pytest.mark.parametrize("profile", PROFILES)
def test_what_the_ego_sees_lies_in_the_space_until_the_last_step(profile: str) -> None:
    env = made(profile=profile, density=2.0)
    endings = set()
    for seed in range(20):
        steps = until_over(env, seed, whims(seed))
        assert all(step[0] in env.observation_space for step in steps)
        endings.add(steps[-1][4]["ending"])
    assert endings >= {"rear_end", "side"}


def test_an_episode_is_that_of_a_simulation_with_the_same_seed() -> None:
    env = made(traffic="outside_traffic", density=1.5)
    traffic = make_traffic("outside_traffic")
    agents = {name: make_agent(name) for name in traffic.agents}
    simulation = Simulation(SceneSettings(density=1.5), 1, None, traffic, agents)
    for seed in (5, 6, 7):
        steps = until_over(env, seed, whims(seed))
        simulation.reset(np.array([seed], dtype=np.uint64))
        actions = whims(seed)
        for observation, *rest in steps:
            expected = neighbours(simulation.scene, simulation.ego_vehicles)[0]
            np.testing.assert_array_equal(observation, expected)
            if not rest or not (rest[1] or rest[2]):
                simulation.step(np.array([next(actions)]))
        assert steps[-1][4]["ending"] == ENDINGS[simulation.ending[0]]
        assert simulation.ending[0] != RUNNING


def test_the_traffic_can_be_a_scenario_whose_points_are_the_seeds() -> None:
    env, many = made(traffic=CUT_IN), ego_vector_env(4, CUT_IN)
    together, _ = many.reset(seed=20)
    gaps = []
    for seed in range(20, 24):
        steps = until_over(env, seed, whims(seed))
        np.testing.assert_array_equal(together[seed - 20], steps[0][0])
        simulation = env.unwrapped.simulation
        assert simulation.drivers.tolist() == [["", "prescribed", "idm_mobil"]]
        env.reset(seed=seed)
        front = simulation.scene.x[0, 0] + 5.0
        gaps.append(simulation.scene.x[0, 1] - front)
        assert simulation.scene.x[0, 2] == simulation.scene.x[0, 0] - 45.0
    assert min(gaps) >= 5.0
    assert max(gaps) <= 50.0
    assert len(set(gaps)) == 4


@pytest.mark.parametrize(
    ("as_in_a_suite", "plain"),
    [
        ({"mixture": {"idm_mobil": 0.5, "level_0": 0.5}}, {"idm_mobil": 0.5, "level_0": 0.5}),
        ({"name": "idm_mobil"}, "idm_mobil"),
    ],
)
def test_a_traffic_can_be_given_as_in_a_suite(as_in_a_suite: Any, plain: Any) -> None:
    drivers = []
    for traffic in (as_in_a_suite, plain):
        env = made(traffic=traffic, **SHORT)
        env.reset(seed=3)
        drivers.append(env.unwrapped.simulation.drivers.tolist())
    assert drivers[0] == drivers[1]


def test_a_traffic_model_can_have_options() -> None:
    env = made(traffic={"name": "pch", "options": {"tau": 0.0}}, **SHORT)
    env.reset(seed=3)
    names = {*env.unwrapped.simulation.drivers[0].tolist()} - {""}
    assert all("competitive" in name for name in names)


def test_keys_of_a_scene_may_be_numbers_of_numpy() -> None:
    env = made(lanes=np.int64(4), density=np.float32(1.5), traffic_vehicles=np.int32(6))
    settings = env.unwrapped.simulation.settings
    assert (settings.lanes, settings.density, settings.traffic_vehicles) == (4, 1.5, 6)


def test_episodes_of_a_scenario_without_a_seed_need_points_without_end() -> None:
    with pytest.raises(InputError, match=r"has 1,073,741,824 points; .*`points: random`"):
        made(traffic=CUT_IN).reset()
    drawn = {"scenario": {**CUT_IN["scenario"], "points": "random"}}
    many = ego_vector_env(3, drawn)
    seen, _ = many.reset()
    assert len(np.unique(seen[:, 1, 1])) == 3


def test_the_vector_environment_has_the_same_episodes() -> None:
    many = gymnasium.make_vec(ID, num_envs=3, vectorization_mode="vector_entry_point", **SHORT)
    assert isinstance(many, HighwayVectorEnv)
    together, _ = many.reset(seed=4)
    one = made(**SHORT)
    for row in range(3):
        np.testing.assert_array_equal(together[row], one.reset(seed=4 + row)[0])
    seen, rewards, terminated, truncated, _ = many.step(np.full(3, FASTER))
    expected = one.step(FASTER)  # of the last of the three
    np.testing.assert_array_equal(seen[2], expected[0])
    assert (rewards[2], terminated[2], truncated[2]) == expected[1:4]
    assert many.single_observation_space == one.observation_space


@pytest.mark.parametrize("mixed", [False, True])
def test_a_traffic_is_a_network_by_its_path(network_file: Callable[..., Path], mixed: bool) -> None:
    weights = np.zeros((35, 5))
    weights[0, SLOWER] = 1.0  # the ego's presence, which is always 1
    path = str(network_file(weights))
    many = gymnasium.make_vec(
        ID,
        num_envs=2,
        vectorization_mode="vector_entry_point",
        traffic={path: 1.0} if mixed else path,
    )
    many.reset(seed=4)
    for _ in range(15):
        many.step(np.full(2, SLOWER))
    # The profile's lowest speed; vehicles start between 23.1 and 26.4 m/s.
    np.testing.assert_allclose(many.simulation.scene.speed, 22.0, atol=0.5)


def test_episodes_of_stock_highway_are_there_with_its_observations_and_rewards() -> None:
    config = {"lanes_count": 4, "vehicles_count": 12, "duration": 8}
    theirs = gymnasium.make("highway-v0", config=config)
    scene = {"profile": "highway-env", "lanes": 4, "traffic_vehicles": 12, "ego_slots": 1}
    arguments = {**scene, "decision_hz": 1, "duration_s": 8.0, "observation": "Kinematics"}
    ours = made(**arguments)
    many = ego_vector_env(2, **arguments)
    assert ours.observation_space == many.single_observation_space == theirs.observation_space
    together, _ = many.reset(seed=1)
    for seed in (1, 2):
        expected = until_over(theirs, seed, whims(seed))
        found = until_over(ours, seed, whims(seed))
        np.testing.assert_array_equal(found[0][0], together[seed - 1])
        for step, (there, here) in enumerate(zip(expected, found, strict=True)):
            np.testing.assert_allclose(here[0], there[0], rtol=0, atol=1e-6, err_msg=f"{step}")
            assert here[1:4] == pytest.approx(there[1:4])


def test_seeds_reproduce_and_without_one_the_next_episode_follows_from_the_last_seed() -> None:
    env = made(**SHORT)
    runs = []
    for _ in range(2):
        _, first = env.reset(seed=3)
        runs.append([first["seed"], *(env.reset()[1]["seed"] for _ in range(3))])
    assert runs[0] == runs[1]
    assert len(set(runs[0])) == 4
    assert all(seed >= EVALUATION_SEEDS for seed in runs[0][1:])


def test_gymnasium_imports_what_registers_it_when_its_name_says_so() -> None:
    code = (
        "import gymnasium, sys; assert 'charms_bench' not in sys.modules;"
        "print(gymnasium.make('charms_bench.envs:charms_bench/Ego-v0').reset()[0].shape)"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert finished.stdout == "(7, 5)\n", finished.stderr


def test_registering_the_environments_imports_nothing_heavy() -> None:
    code = (
        "import sys, charms_bench.envs; print({'numba', 'highway_env', 'torch'} & {*sys.modules})"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert finished.stdout == "set()\n", finished.stderr


@pytest.mark.parametrize("mode", ["sync", "vector_entry_point"])
def test_gymnasium_makes_many_either_way(mode: str) -> None:
    many = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, **SHORT)
    assert many.reset(seed=0)[0].shape == (2, 7, 5)
    assert many.step(np.array([IDLE, FASTER]))[1].shape == (2,)


def test_without_a_seed_two_environments_do_not_repeat_each_other() -> None:
    assert made().reset()[1]["seed"] != made().reset()[1]["seed"]
    assert ego_vector_env(2, **SHORT).reset()[0].shape == (2, 7, 5)


def test_time_that_is_over_truncates_and_the_info_says_so() -> None:
    *_, last = until_over(
        made(duration_s=1.0, traffic_vehicles=0, ego_slots=1), 0, iter([IDLE] * 9)
    )
    assert last[2:4] == (False, True)
    assert last[4]["ending"] == "time"


def test_scenes_and_traffics_are_what_was_asked_for() -> None:
    env = EgoEnv(traffic={"idm_mobil": 0.5, "stackelberg": 0.5}, lanes=5, traffic_vehicles=40)
    env.reset(seed=0)
    assert env.simulation.scene.x.shape == (1, 41)
    assert set(env.simulation.drivers[0]) == {"", "idm_mobil", "stackelberg"}
    assert env.simulation.scene.road.lanes == 5
    given = EgoEnv(
        traffic=make_traffic("stackelberg"), profile={"name": "charms", "speed_max_mps": 35}
    )
    assert given.simulation.settings.profile.speed_max_mps == 35


def test_an_episode_can_be_tried_again_from_any_decision() -> None:
    """As a planner does: several futures from one state, none of which changes the others."""
    env = made(density=2.0).unwrapped
    env.reset(seed=3)
    for _ in range(7):
        env.step(IDLE)
    start, first = env.get_state(), [env.step(FASTER) for _ in range(5)]
    observation = env.set_state(start)
    np.testing.assert_array_equal(env.step(FASTER)[0], first[0][0])
    again, info = made(density=2.0).reset(options={"state": start})
    np.testing.assert_array_equal(again, observation)
    assert info["seed"] == 3


def test_states_that_an_environment_cannot_continue_are_rejected() -> None:
    env = EgoEnv(**SHORT)
    env.reset(seed=0)
    with pytest.raises(InputError, match="option 'state': found int, expected a SceneState"):
        env.reset(options={"state": 3})
    env.simulation.advance()
    with pytest.raises(InputError, match="saved 1 simulation steps after a decision"):
        env.set_state(env.get_state())
    until_over(env, 0, whims(0))
    with pytest.raises(InputError, match="of episode 0 was saved after the episode had ended"):
        env.set_state(env.get_state())


def test_another_reward_takes_the_place_of_highway_envs() -> None:
    env = made(reward=Forward(), traffic_vehicles=0, ego_slots=1)
    env.reset(seed=0)
    assert env.step(IDLE)[1] == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"lane": 3}, "charms_bench/Ego-v0: lane: unknown key"),
        ({"lanes": 1}, "charms_bench/Ego-v0: lanes: Input should be greater.*found 1"),
        ({"duration_s": 0.01}, "charms_bench/Ego-v0: duration_s is shorter than one decision"),
        ({"profile": "charm"}, "profile: no profile named 'charm'.*Did you mean 'charms'"),
        ({"observation": "Kinematic"}, "no observation named 'Kinematic'.*Did you mean 'Kin"),
        ({"traffic": {"idm_mobil": 0.5}}, "must be non-negative and sum to 1"),
        ({"traffic": {"idm_mobil": float("nan")}}, "must be non-negative and sum to 1"),
        ({"traffic": {"idm_mobil": None}}, "must be non-negative and sum to 1"),
        ({"traffic": ["idm_mobil"]}, "traffic: found list, expected a name, a dictionary or a Tra"),
        ({"scene": {"road": "merge-v9"}}, "no road named 'merge-v9'.*Did you mean 'merge-v"),
        (
            {"road": "merge-v0", "lanes": 4},
            "the road 'merge-v0' has its own lanes and vehicles; remove scene.lanes",
        ),
        (
            {"road": "exit-v1", "lanes": 3},
            "remove scene.lanes, or give the road configuration.lanes_count instead",
        ),
        (
            {"road": "intersection-multi-agent-v1", "traffic": CUT_IN},
            "a scenario has one ego, and the road 2; expected one, as on intersection-v1",
        ),
        (
            {"traffic": {"road": "merge-v0", "drivers": "human"}},
            "a road is no traffic model; give scene={'road': 'merge-v0'}, traffic='human'",
        ),
        ({"traffic": "environment"}, "traffic: 'environment' needs scene={'road': ...}"),
        ({"traffic": {"name": "pch", "optons": {}}}, "charms_bench/Ego-v0: optons: unknown key"),
        ({"reward": 5}, "charms_bench/Ego-v0: reward is 5; expected a function or a Reward"),
        ({"traffic": {"scenario": {}}}, "charms_bench/Ego-v0: scenario.ego: Field required"),
        (
            {"traffic": CUT_IN, "inflow": {"vehicles_per_hour_and_lane": 900, "capacity": 9}},
            "scene.inflow: a scenario places all vehicles; remove one",
        ),
        (
            {"traffic": {"scenario": {**CUT_IN["scenario"], "ego": {"lane": 4, "speed_mps": 28}}}},
            "charms_bench/Ego-v0: scenario.ego.lane: lane 4 is not on the road",
        ),
    ],
)
def test_what_cannot_be_is_one_message(arguments: dict[str, Any], message: str) -> None:
    for make in (EgoEnv, lambda **scene: ego_vector_env(2, **scene)):
        with pytest.raises(InputError, match=message):
            make(**arguments)


def test_unknown_traffics_actions_and_options_are_named() -> None:
    with pytest.raises(RegistryError, match="no traffic named 'idm'"):
        EgoEnv(traffic="idm")
    env = EgoEnv()
    with pytest.raises(InputError, match="got speed"):
        env.reset(options={"speed": 3})
    with pytest.raises(InputError, match="reset: options is 5; expected a dictionary"):
        env.reset(options=5)  # type: ignore[arg-type]
    env.reset()
    with pytest.raises(InputError, match="action 5; expected 0 to 4: LANE_LEFT, IDLE"):
        env.step(5)


@pytest.mark.parametrize(
    ("left_out", "names"),
    [
        ({"lateral": False}, ("SLOWER", "IDLE", "FASTER")),
        ({"longitudinal": False}, ("LANE_LEFT", "IDLE", "LANE_RIGHT")),
    ],
)
def test_three_meta_actions_are_those_of_highway_env(
    left_out: dict[str, bool], names: tuple[str, ...]
) -> None:
    config = {"action": {"type": "DiscreteMetaAction", **left_out}}
    stock: Any = gymnasium.make("highway-v0", config=config).unwrapped
    assert (*stock.action_type.actions.values(),) == names
    three, five, many = made(**left_out), made(), ego_vector_env(2, **left_out)
    assert three.action_space == many.single_action_space == stock.action_space
    for env in (three, five, many):
        env.reset(seed=1)
    for action, name in enumerate(names):
        *found, info = three.step(action)
        *expected, all_info = five.step(ACTIONS.index(name))
        np.testing.assert_equal(found, expected)
        np.testing.assert_array_equal(many.step([action, action])[0][0], expected[0])
        chosen = [ACTIONS.index(each) for each in names]
        assert info["action_mask"].tolist() == all_info["action_mask"][chosen].tolist()
        assert many.action_masks().shape == (2, 3)
    with pytest.raises(InputError, match="action 3; expected 0 to 2: " + ", ".join(names)):
        three.step(3)


def test_without_any_control_there_is_no_environment() -> None:
    with pytest.raises(InputError, match="neither longitudinal nor lateral"):
        EgoEnv(longitudinal=False, lateral=False)


def test_after_the_end_there_is_nothing_to_step() -> None:
    env = EgoEnv(duration_s=1.0, render_mode="rgb_array", traffic_vehicles=8)
    env.reset(seed=0)
    for _ in range(3):
        env.step(IDLE)
    with pytest.raises(ResetNeeded, match="after the end of the episode"):
        env.step(IDLE)
    env.reset()
    env.step(IDLE)


@pytest.mark.parametrize("given", [1, np.int64(1), np.array(1), np.array(1, dtype=np.uint8)])
def test_an_action_may_be_any_whole_number(given: Any) -> None:
    env = EgoEnv(**SHORT)
    env.reset(seed=1)
    expected = env.step(IDLE)[0]
    env.reset(seed=1)
    np.testing.assert_array_equal(env.step(given)[0], expected)


def test_tensors_are_actions_too() -> None:
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    one, many = EgoEnv(**SHORT), ego_vector_env(2, **SHORT)
    many.reset(seed=3)
    together = many.step(torch.tensor([IDLE, FASTER]))[0]
    for seed, action in ((3, IDLE), (4, FASTER)):
        one.reset(seed=seed)
        np.testing.assert_array_equal(one.step(torch.tensor(action))[0], together[seed - 3])


def test_actions_sampled_with_the_mask_are_of_lanes_that_exist() -> None:
    env = EgoEnv(traffic="level_0")
    env.action_space.seed(0)
    _, info = env.reset(seed=0)
    for _ in range(40):
        action = env.action_space.sample(info["action_mask"])
        scene, ego = env.simulation.scene, env.simulation.ego_vehicles
        lanes = {int(scene.lane[ego][0]), int(scene.target_lane[ego][0])}
        assert (lanes, action) not in (({0}, LANE_LEFT), ({2}, LANE_RIGHT))
        _, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            _, info = env.reset()
        assert info["action_mask"].tolist() == env.action_masks().astype(int).tolist()


def test_continuous_actions_have_no_mask() -> None:
    _, info = EgoEnv(actions="continuous", traffic="level_0").reset(seed=0)
    assert info == {"seed": 0}
