"""Many learners as a PettingZoo environment: its own tests, names, and agents that leave."""

import warnings
from functools import partial
from typing import Any

import numpy as np
import pytest
from pettingzoo.utils import parallel_to_aec

from charms_bench.engine.endings import ENDINGS
from charms_bench.engine.neighbours import locate
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.envs.parallel_env import HighwayParallelEnv
from charms_bench.errors import InputError
from charms_bench.world.actions import FASTER, IDLE, SLOWER
from charms_bench.world.observations import EGO
from charms_bench.world.profile import PROFILES

with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
    # Its first module imports a game of PettingZoo's in a way that PettingZoo has deprecated.
    from pettingzoo.test import parallel_api_test, parallel_seed_test

KINDS: list[dict[str, Any]] = [
    {},
    {"learners": (0, 3, 7), "density": 2.0},
    {"profile": "highway-env", "observation": "Kinematics", "lanes": 4, "traffic_vehicles": 9},
]


def until_over(env: HighwayParallelEnv, seed: int) -> list[tuple[Any, ...]]:
    """The results of an episode with random actions, each with the actions."""
    rng = np.random.default_rng(seed)
    steps: list[tuple[Any, ...]] = [env.reset(seed=seed)]
    while env.agents:
        actions = {agent: int(rng.integers(5)) for agent in env.agents}
        steps.append((actions, *env.step(actions)))
    return steps


@pytest.mark.parametrize("kind", KINDS)
def test_pettingzoos_own_tests_have_nothing_to_say(kind: dict[str, Any]) -> None:
    parallel_api_test(HighwayParallelEnv(**kind), num_cycles=1000)
    parallel_seed_test(partial(HighwayParallelEnv, **kind))


def test_it_has_the_episodes_of_the_vector_environment() -> None:
    """Until the last agent has left; the vector environment then starts the next scene."""
    single, many = HighwayParallelEnv(density=2.0), LearnersVectorEnv(1, density=2.0)
    (first, infos), *steps = until_over(single, seed=6)
    np.testing.assert_array_equal(np.array([*first.values()]), many.reset(seed=6)[0])
    assert infos["vehicle_0"]["seed"] == 6
    names = np.array(single.possible_agents)
    for actions, observations, rewards, terminated, truncated, infos in steps:
        alive = many.alive
        assert [*actions] == names[alive].tolist()
        expected = many.step(np.array([actions.get(name, 0) for name in names]))
        for values, arrays in zip((rewards, terminated, truncated), expected[1:4], strict=True):
            assert [*values.values()] == arrays[alive].tolist()
        for name, row in zip(names[alive], np.nonzero(alive)[0], strict=True):
            mask = expected[4]["action_mask"][row]
            if terminated[name] or truncated[name]:
                ending = expected[4]["final_info"]["ending"][row]
                assert infos[name]["ending"] == ENDINGS[ending]
                np.testing.assert_array_equal(observations[name], expected[4]["final_obs"][row])
            else:
                assert "ending" not in infos[name]
                assert infos[name]["action_mask"].tolist() == mask.tolist()
                np.testing.assert_array_equal(observations[name], expected[0][row])
    assert len(steps) > 5


def test_agents_that_crash_leave_and_their_wrecks_stay() -> None:
    env = HighwayParallelEnv(traffic_vehicles=2, ego_slots=1, duration_s=2.0)
    env.reset(seed=0)
    scene = env.simulation.scene
    scene.x[0], scene.y[0], scene.speed[0] = (100.0, 106.0, 250.0), 4.0, (33.0, 22.0, 25.0)
    locate(scene, np.array([0]))
    _, _, terminated, truncated, infos = env.step(dict.fromkeys(env.agents, IDLE))
    assert terminated == {"vehicle_0": True, "vehicle_1": True, "vehicle_2": False}
    assert not any(truncated.values())
    assert infos["vehicle_0"]["ending"] == "rear_end"
    assert env.agents == ["vehicle_2"]
    before = scene.x[0].copy()
    for _ in range(5):
        observations, _, _, truncated, infos = env.step({"vehicle_2": IDLE})
        assert [*observations] == ["vehicle_2"]
    assert (scene.x[0] > before).all()
    assert truncated == {"vehicle_2": True}
    assert infos["vehicle_2"]["ending"] == "time"
    assert env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})


@pytest.mark.parametrize("profile", PROFILES)
def test_a_name_means_the_same_vehicle_for_the_whole_episode(profile: str) -> None:
    env = HighwayParallelEnv((0, 2, 5), profile=profile, traffic_vehicles=9)
    env.reset(seed=2)
    scene = env.simulation.scene
    (ego,) = scene.ego
    others = [place for place in range(10) if place != ego]
    places = {"vehicle_0": ego, "vehicle_2": others[1], "vehicle_5": others[4]}
    assert env.possible_agents == [*places]
    rng = np.random.default_rng(0)
    while env.agents:
        observations, *_ = env.step({agent: int(rng.integers(5)) for agent in env.agents})
        for agent, seen in observations.items():
            assert seen[EGO, 2] * 12 == pytest.approx(scene.y[0, places[agent]], abs=1e-5)


def test_pettingzoos_wrappers_take_it() -> None:
    env = parallel_to_aec(HighwayParallelEnv(traffic_vehicles=5, duration_s=2.0))
    env.reset(seed=1)
    for _ in env.agent_iter():
        *_, terminated, truncated, _ = env.last()
        env.step(None if terminated or truncated else FASTER)
    assert not env.agents


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"vehicle_0": IDLE}, "missing: vehicle_1; unexpected: none"),
        ({"vehicle_0": 1, "vehicle_1": 1, "vehicle_2": 1}, "missing: none; unexpected: vehicle_2"),
        ({"vehicle_0": 1, "vehicle_1": 5}, "vehicle_1: no action 5; expected 0 to 4: LANE_LEFT"),
    ],
)
def test_wrong_actions_are_named(actions: dict[str, int], message: str) -> None:
    env = HighwayParallelEnv((0, 1))
    env.reset(seed=0)
    with pytest.raises(InputError, match=message):
        env.step(actions)


def test_three_meta_actions_mean_the_same() -> None:
    three, five = HighwayParallelEnv(lateral=False), HighwayParallelEnv()
    for env in (three, five):
        env.reset(seed=1)
    assert three.action_space("vehicle_3").n == 3
    for action, same in ((0, SLOWER), (1, IDLE), (2, FASTER)):
        found = three.step(dict.fromkeys(three.agents, action))
        expected = five.step(dict.fromkeys(five.agents, np.int64(same)))
        np.testing.assert_equal(found[:4], expected[:4])
    assert found[4]["vehicle_0"]["action_mask"].tolist() == [1, 1, 1]
