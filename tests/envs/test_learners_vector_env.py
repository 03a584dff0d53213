"""Many learners as arrays: rows of learners that have left, and new scenes."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from charms_bench.engine.endings import REAR_END, TIME
from charms_bench.engine.neighbours import locate
from charms_bench.envs.ego_env import ego_vector_env
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.errors import InputError
from charms_bench.world.actions import ACTIONS, IDLE, LANE_LEFT, LANE_RIGHT
from charms_bench.world.observations import EGO, neighbours
from charms_bench.world.scene import EVALUATION_SEEDS, Floats, Scene, Vehicles

SMALL = {"traffic_vehicles": 4, "ego_slots": 1}


def distance(scene: Scene, vehicles: Vehicles) -> Floats:
    """The position along the road, m."""
    return scene.x[vehicles]


def random_steps(env: LearnersVectorEnv, steps: int, seed: int = 0) -> list[tuple[Any, ...]]:
    """The results of steps with random actions, with `alive` before each of them."""
    rng, results = np.random.default_rng(seed), []
    for _ in range(steps):
        alive = env.alive
        results.append((alive, *env.step(rng.integers(len(ACTIONS), size=env.num_envs))))
    return results


def crash(env: LearnersVectorEnv, row: int) -> None:
    """Puts vehicle 0 of a scene behind vehicle 1, and all others far away."""
    scene = env.simulation.scene
    scene.x[row], scene.y[row] = (100.0, 106.0, *(300.0 + 100 * k for k in range(3))), 4.0
    scene.speed[row], scene.target_lane[row] = (33.0, 22.0, 25.0, 25.0, 25.0), 1
    locate(scene, np.array([row]))


def test_what_it_returns_lies_in_its_spaces_and_has_one_row_per_learner() -> None:
    env = LearnersVectorEnv(3, **SMALL)
    observations, infos = env.reset(seed=7)
    assert env.num_envs == 15
    assert env.learners == (0, 1, 2, 3, 4)
    assert "final_info" not in infos
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    env.action_space.seed(0)
    for _ in range(80):
        assert observations in env.observation_space
        observations, rewards, terminations, truncations, _ = env.step(env.action_space.sample())
        assert rewards.shape == terminations.shape == truncations.shape == (15,)


def test_rows_are_those_of_the_scenes_vehicles() -> None:
    env = LearnersVectorEnv(2, (0, 3), **SMALL)
    observations, _ = env.reset(seed=1)
    scene = env.simulation.scene
    expected = neighbours(scene, (np.array([0, 0, 1, 1]), np.array([0, 3, 0, 3])))
    np.testing.assert_array_equal(observations, expected)
    np.testing.assert_array_equal(observations[:, EGO, 2] * 12, scene.y[:, [0, 3]].ravel())


def test_a_learner_that_has_left_has_zeros_until_its_scene_is_over() -> None:
    env = LearnersVectorEnv(2, duration_s=2.0, reward=distance, **SMALL)
    env.reset(seed=0)
    crash(env, 1)
    idle = np.full(10, IDLE)
    observations, rewards, terminations, truncations, infos = env.step(idle)
    assert np.nonzero(terminations)[0].tolist() == [5, 6]
    assert not truncations.any()
    assert (rewards > 0).all()
    assert not observations[[5, 6]].any()
    assert env.alive.tolist() == [True] * 5 + [False, False, True, True, True]
    assert (infos["final_obs"][5][EGO, :2] == 1.0).all()
    assert infos["_final_obs"].tolist() == terminations.tolist()
    final = infos["final_info"]
    assert final["ending"][5:7].tolist() == [REAR_END, REAR_END]
    assert (final["steps"][5], final["seed"][5]) == (1, 1)
    for _ in range(4):
        observations, rewards, terminations, truncations, infos = env.step(idle)
        assert not observations[[5, 6]].any()
        assert rewards[[5, 6]].tolist() == [0.0, 0.0]
        assert not (terminations | truncations).any()
        assert "final_info" not in infos
    observations, _, terminations, truncations, infos = env.step(idle)
    assert not terminations.any()
    assert np.nonzero(~truncations)[0].tolist() == [5, 6]
    assert (infos["final_info"]["ending"][[0, 9]] == TIME).all()
    assert env.alive.all()
    assert (observations[:, EGO, 0] == 1.0).all()


def test_a_scene_without_learners_is_replaced_by_the_next_within_the_step() -> None:
    env = LearnersVectorEnv(2, (0, 1), **SMALL)
    env.reset(seed=0)
    crash(env, 0)
    observations, _, terminations, _, infos = env.step(np.full(4, IDLE))
    assert terminations.tolist() == [True, True, False, False]
    assert env.alive.all()
    # As a single environment that was seeded with 0 draws the seed of its next episode.
    drawn = EVALUATION_SEEDS + int(np.random.default_rng(0).integers(2**62))
    assert env.simulation.seeds.tolist() == [drawn, 1]
    other = LearnersVectorEnv(1, (0, 1), **SMALL)
    np.testing.assert_array_equal(observations[:2], other.reset(seed=drawn)[0])
    assert infos["final_info"]["seed"].tolist() == [0, 0, 0, 0]


def test_actions_of_learners_that_have_left_have_no_effect() -> None:
    found = []
    for action in range(len(ACTIONS)):
        env = LearnersVectorEnv(1, **SMALL)
        env.reset(seed=0)
        crash(env, 0)
        for _ in range(10):
            env.step(np.where(env.alive, IDLE, action))
        found.append((env.simulation.scene.x.copy(), env.simulation.scene.target_lane.copy()))
    for one in found[1:]:
        np.testing.assert_array_equal(one, found[0])


def test_without_a_seed_scenes_are_not_those_that_suites_evaluate_on() -> None:
    env = LearnersVectorEnv(2, **SMALL)
    drawn = set()
    for _ in range(2):
        env.reset()
        drawn |= {*env.simulation.seeds.tolist()}
    assert len(drawn) == 4
    assert min(drawn) >= EVALUATION_SEEDS


def test_highway_envs_observation_can_be_chosen() -> None:
    env = LearnersVectorEnv(2, observation={"type": "Kinematics", "vehicles_count": 3}, **SMALL)
    assert env.reset(seed=0)[0].shape == (10, 3, 5)
    assert env.step(np.full(10, IDLE))[0].shape == (10, 3, 5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"lane": 3}, "LearnersVectorEnv: lane: unknown key"),
        ({"learners": (0, 21)}, "learners: found 0, 21; expected different numbers from 0 to 20"),
        ({"observation": "Kinematic"}, "no observation named 'Kinematic'"),
    ],
)
def test_what_cannot_be_is_one_message(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        LearnersVectorEnv(2, **arguments)


def test_reset_takes_no_state_of_egos_alone() -> None:
    state = ego_vector_env(2).get_state().scenes
    with pytest.raises(InputError, match="the state has 1 learners in a scene; expected 3"):
        LearnersVectorEnv(2, range(3)).reset(options={"state": state})


def test_every_learner_has_its_mask() -> None:
    env = LearnersVectorEnv(2, (0, 3), **SMALL)
    _, infos = env.reset(seed=1)
    lane = env.simulation.scene.lane[:, [0, 3]].ravel()
    assert infos["action_mask"][:, LANE_LEFT].tolist() == (lane > 0).tolist()
    assert infos["action_mask"][:, LANE_RIGHT].tolist() == (lane < 2).tolist()
    crash(env, 0)
    *_, infos = env.step(np.full(4, IDLE))
    assert infos["action_mask"][~env.alive].all()
