"""Environments of different scenes, side by side."""

from typing import Any

import numpy as np
from charms_agents.training.episodes import Episodes, Step
from charms_agents.training.rewards import StyleReward, Weights
from handmade_scene import Idle

from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.traffic import OneAgent, Placed
from charms_bench.world.actions import ACTIONS
from charms_bench.world.observations import Neighbours
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

COUNTS, LANES = (2, 3), (2, 4)
"""Environments and lanes of the two scenes."""


def environment(which: int) -> HighwayVectorEnv[Any]:
    settings = SceneSettings(
        lanes=LANES[which], traffic_vehicles=8, ego_slots=2, density=2.0, duration_s=4.0
    )
    reward = StyleReward(Weights(safety=1.0, efficiency=1.0, comfort=1.0), 0.0)
    agents = {"idle": Idle()}
    first_seed, seen = 1000 * which, Neighbours(commands=True)
    return HighwayVectorEnv(
        settings, COUNTS[which], OneAgent("idle"), agents, reward, first_seed, seen
    )


CUT_OUT = Scenario.model_validate(
    {
        "parameters": {"gap_m": [20, 60]},
        "points": "random",
        "ego": {"lane": 1, "speed_mps": 28.0},
        "vehicles": [
            {
                "name": "leader",
                "lane": 1,
                "ahead_of": "ego",
                "gap_m": 30,
                "speed_mps": 28.0,
                "actions": [{"at_s": 0, "lane": 0, "duration_s": 2}],
            },
            {"name": "standing", "lane": 1, "ahead_of": "leader", "gap_m": "gap_m", "speed_mps": 0},
        ],
    }
)


def hazards() -> HighwayVectorEnv[Any]:
    settings = SceneSettings.model_validate(
        {"duration_s": 4.0, "profile": {"name": "charms", "speed_min_mps": 0.0}}
    ).of_scenario(CUT_OUT)
    reward = StyleReward(Weights(safety=1.0, efficiency=1.0, comfort=1.0), 0.0)
    seen = Neighbours(commands=True)
    return HighwayVectorEnv(settings, 4, Placed(CUT_OUT.agents), {}, reward, 2**40, seen)


def both() -> Episodes:
    return Episodes([environment(0), environment(1)])


def decisions(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.integers(len(ACTIONS), size=(count, sum(COUNTS)))


def assert_same(one: Step, other: Step) -> None:
    for name, array in one._asdict().items():
        if name == "facts":
            assert array == other.facts
        else:
            np.testing.assert_array_equal(array, getattr(other, name), err_msg=name)


def test_two_environments_go_on_as_they_do_apart() -> None:
    together, apart = both(), [environment(0), environment(1)]
    first = np.concatenate([each.reset()[0] for each in apart])
    np.testing.assert_array_equal(together.reset(), first)
    ended = 0
    for actions in decisions(40):
        step = together.step(actions)
        parts = [
            each.step(own) for each, own in zip(apart, np.split(actions, COUNTS[:1]), strict=True)
        ]
        for name, part in (("observed", 0), ("rewards", 1), ("failed", 2)):
            expected = np.concatenate([each[part] for each in parts])
            np.testing.assert_array_equal(getattr(step, name), expected, err_msg=name)
        over = np.concatenate([each[2] | each[3] for each in parts])
        np.testing.assert_array_equal(step.ended, over)
        told = [each[4].get("final_obs", [None] * n) for each, n in zip(parts, COUNTS, strict=True)]
        last = [seen for each in told for seen in each]
        for k in range(sum(COUNTS)):
            following = last[k] if over[k] else step.observed[k]
            np.testing.assert_array_equal(step.following[k], following)
        assert len(step.facts) == over.sum()
        ended += int(over.sum())
    assert ended > sum(COUNTS)


def test_saved_episodes_go_on_in_environments_that_are_made_anew() -> None:
    whole = both()
    whole.reset()
    for actions in decisions(9):
        step = whole.step(actions)
    stored = {name: array.copy() for name, array in whole.arrays().items()}
    resumed = both()
    np.testing.assert_array_equal(resumed.load_arrays(stored), step.observed)
    for actions in decisions(30, seed=1):
        assert_same(resumed.step(actions), whole.step(actions))


def test_saved_episodes_of_a_scenario_go_on_in_an_environment_that_is_made_anew() -> None:
    whole = Episodes([hazards()])
    whole.reset()
    for actions in decisions(9)[:, :4]:
        step = whole.step(actions)
    stored = {name: array.copy() for name, array in whole.arrays().items()}
    resumed, ended = Episodes([hazards()]), 0
    np.testing.assert_array_equal(resumed.load_arrays(stored), step.observed)
    for actions in decisions(30, seed=1)[:, :4]:
        step = whole.step(actions)
        assert_same(resumed.step(actions), step)
        ended += int(step.ended.sum())
    assert ended > 4


def test_one_environment_alone_is_stepped_as_it_is() -> None:
    alone, apart = Episodes([environment(0)]), environment(0)
    np.testing.assert_array_equal(alone.reset(), apart.reset()[0])
    for actions in decisions(15)[:, : COUNTS[0]]:
        observed, rewards, *_ = apart.step(actions)
        step = alone.step(actions)
        np.testing.assert_array_equal(step.observed, observed)
        np.testing.assert_array_equal(step.rewards, rewards)
