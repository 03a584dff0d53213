"""Environments take meta-actions of one's own."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from charms_bench import DEFAULT_ACTIONS, MetaAction
from charms_bench.envs import ID
from charms_bench.envs.ego_env import ego_vector_env
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.errors import InputError

BRAKE = {"name": "BRAKE", "speed_from_present_mps": -6.0}
SIX = [*DEFAULT_ACTIONS, MetaAction(**BRAKE)]  # type: ignore[arg-type]
ALONE: dict[str, Any] = {"traffic_vehicles": 0, "ego_slots": 1}
PAIR: dict[str, Any] = {"traffic_vehicles": 1, "ego_slots": 1, "density": 0.2}


def test_the_space_the_mask_and_the_braking_are_those_of_the_actions() -> None:
    env = gymnasium.make(ID, actions=SIX, **ALONE)
    _, info = env.reset(seed=0)
    assert env.action_space == gymnasium.spaces.Discrete(6)
    assert info["action_mask"].shape == (6,)
    assert info["action_mask"][[1, 3, 4, 5]].all()
    env.step(5)
    made = env.unwrapped.simulation  # type: ignore[attr-defined]
    assert made.scene.acceleration[0, 0] == -7.5
    assert made.scene.speed[0, 0] == pytest.approx(27.5)


def test_actions_can_be_plain_values_and_many_environments_take_them() -> None:
    named = ["LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER", BRAKE]
    env = ego_vector_env(3, actions=named, first_seed=0, **ALONE)
    _, infos = env.reset()
    assert infos["action_mask"].shape == (3, 6)
    env.step(np.array([1, 5, 4]))
    np.testing.assert_allclose(env.simulation.scene.speed[:, 0], [30.0, 27.5, 29.5833333])


@pytest.mark.parametrize(
    ("left_out", "names"),
    [
        ("lateral", ("IDLE", "FASTER", "SLOWER", "BRAKE")),
        ("longitudinal", ("LANE_LEFT", "IDLE", "LANE_RIGHT")),
    ],
)
def test_lateral_or_longitudinal_actions_can_be_left_out(
    left_out: str, names: tuple[str, ...]
) -> None:
    env = gymnasium.make(ID, actions=SIX, **{left_out: False}, **ALONE)
    assert env.unwrapped._episodes.action_names == names  # type: ignore[attr-defined]
    env.reset(seed=0)
    env.step(len(names) - 1)
    made = env.unwrapped.simulation  # type: ignore[attr-defined]
    assert made.action_names[made.named_actions[0, 0]] == names[-1]


def test_learners_brake_by_the_sixth_action() -> None:
    env = LearnersVectorEnv(2, learners=(0, 1), actions=SIX, **PAIR)
    env.reset(seed=0)
    before = env.simulation.scene.target_speed.copy()
    env.step(np.array([5, 1, 1, 5]))
    np.testing.assert_array_equal(env.simulation.scene.target_speed < before, np.eye(2))


def test_a_parallel_environment_has_the_actions_for_each_agent() -> None:
    pytest.importorskip("pettingzoo")
    from charms_bench.envs.parallel_env import HighwayParallelEnv

    env = HighwayParallelEnv(actions=SIX, **PAIR)
    _, infos = env.reset(seed=0)
    assert [env.action_space(agent).n for agent in env.agents] == [6, 6]
    assert infos["vehicle_1"]["action_mask"].shape == (6,)
    env.step({"vehicle_0": 5, "vehicle_1": 1})
    assert env.simulation.scene.acceleration.min() == -7.5


def test_actions_that_are_not_possible_are_named() -> None:
    with pytest.raises(InputError, match="Ego-v0: actions: meta-action 'BRAKE': unknown key 'bra"):
        gymnasium.make(ID, actions=[{"name": "BRAKE", "brakes": 1}])
    with pytest.raises(InputError, match="actions: 'brake'; expected meta or continuous"):
        gymnasium.make(ID, actions="brake")
