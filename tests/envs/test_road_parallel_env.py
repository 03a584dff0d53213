"""highway-env's intersection with several agents as a PettingZoo environment."""

import warnings
from functools import partial
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers its environments
import numpy as np
import pytest

from charms_bench.envs.road_parallel_env import RoadParallelEnv
from charms_bench.errors import InputError

with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
    # Its first module imports a game of PettingZoo's in a way that PettingZoo has deprecated.
    from pettingzoo.test import parallel_api_test, parallel_seed_test

NAME = "intersection-multi-agent-v1"
IDLE, FASTER = 1, 2


def test_pettingzoos_own_tests_have_nothing_to_say() -> None:
    parallel_api_test(RoadParallelEnv(NAME), num_cycles=100)
    parallel_seed_test(partial(RoadParallelEnv, NAME), num_cycles=20)


@pytest.mark.parametrize("seed", [1, 2])
def test_its_episodes_are_those_of_highway_env_also_after_an_agent_has_left(seed: int) -> None:
    env, theirs = RoadParallelEnv(NAME), gymnasium.spec(NAME).make(disable_env_checker=True)
    seen, expected = env.reset(seed=seed)[0], theirs.reset(seed=seed)[0]
    rng, decisions = np.random.default_rng(seed), 0
    places = {agent: k for k, agent in enumerate(env.possible_agents)}
    while env.agents:
        for agent, each in seen.items():
            np.testing.assert_allclose(each, expected[places[agent]], rtol=0, atol=1e-6)
        actions = {agent: int(rng.integers(FASTER + 1)) for agent in env.agents}
        all_actions = [actions.get(agent, IDLE) for agent in env.possible_agents]
        seen, rewards, terminated, truncated, _ = env.step(actions)
        result: Any = theirs.step(tuple(all_actions))
        expected = result[0]
        for agent in actions:
            k = places[agent]
            assert rewards[agent] == pytest.approx(result[1][k])
            assert (terminated[agent], truncated[agent]) == (result[2][k], result[3])
        decisions += 1
    assert decisions > 3


def test_the_number_of_agents_is_that_of_controlled_vehicles() -> None:
    env = RoadParallelEnv(NAME, config={"controlled_vehicles": 3})
    assert env.possible_agents == ["vehicle_0", "vehicle_1", "vehicle_2"]
    seen, infos = env.reset(seed=0)
    assert seen.keys() == infos.keys() == {*env.possible_agents}


def test_an_environment_of_one_agent_is_rejected() -> None:
    with pytest.raises(InputError, match="MultiAgentAction"):
        RoadParallelEnv("intersection-v0")


def test_wrong_actions_are_rejected_by_name() -> None:
    env = RoadParallelEnv(NAME)
    env.reset(seed=0)
    with pytest.raises(InputError, match="missing: vehicle_1; unexpected: none"):
        env.step({"vehicle_0": 0})
    with pytest.raises(InputError, match="vehicle_1: no action 3; expected 0 to 2"):
        env.step({"vehicle_0": 0, "vehicle_1": 3})


def test_pictures_are_those_of_the_environment_with_tuples() -> None:
    env: Any = RoadParallelEnv(NAME, render_mode="rgb_array")
    one: Any = gymnasium.spec(f"charms_bench/{NAME}").make(render_mode="rgb_array").unwrapped
    for each in (env, one):
        each.reset(seed=2)
    env.step(dict.fromkeys(env.agents, FASTER))
    one.step((FASTER, FASTER))
    assert np.array_equal(env.render(), one.render())
    assert env.render().std() > 0


def test_egos_of_which_highway_env_rewards_the_first_only_are_rejected() -> None:
    config = {
        "controlled_vehicles": 2,
        "action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}},
        "observation": {
            "type": "MultiAgentObservation",
            "observation_config": {"type": "Kinematics"},
        },
    }
    with pytest.raises(InputError, match="highway-v0: highway-env has rewards of the first of sev"):
        RoadParallelEnv("highway-v0", config)
