"""Episodes as a gymnasium vector environment: rewards, endings, seeds, and going on later."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from charms_bench.engine.endings import OFF_ROAD, REAR_END, TIME
from charms_bench.engine.neighbours import locate
from charms_bench.engine.simulation import Simulation
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import FASTER, IDLE, LANE_LEFT, Actions
from charms_bench.world.scene import Floats, SceneSettings

ALONE = SceneSettings(traffic_vehicles=0, ego_slots=1)


class Distance:
    """What the ego has driven since the decision, m."""

    def prepare(self, simulation: Simulation, actions: Actions) -> Floats:
        return simulation.scene.x[simulation.ego_vehicles]

    def __call__(self, simulation: Simulation, prepared: Floats) -> Floats:
        return simulation.scene.x[simulation.ego_vehicles] - prepared


def environment(
    settings: SceneSettings, scenes: int = 4, first_seed: int = 0
) -> HighwayVectorEnv[Floats]:
    traffic = {"idm_mobil": make_agent("idm_mobil")}
    return HighwayVectorEnv(
        settings, scenes, OneAgent("idm_mobil"), traffic, Distance(), first_seed
    )


def idle(env: HighwayVectorEnv[Floats]) -> Actions:
    return np.full(env.num_envs, IDLE)


def random_steps(env: HighwayVectorEnv[Floats], seed: int, steps: int) -> list[tuple[Any, ...]]:
    rng = np.random.default_rng(seed)
    return [env.step(rng.integers(5, size=env.num_envs))[:4] for _ in range(steps)]


def test_what_it_returns_lies_in_its_spaces() -> None:
    env = environment(SceneSettings(), scenes=3)
    observations, infos = env.reset(seed=7)
    assert observations in env.observation_space
    assert "final_info" not in infos
    env.action_space.seed(0)
    observations, rewards, terminations, truncations, _ = env.step(env.action_space.sample())
    assert observations in env.observation_space
    assert rewards.shape == terminations.shape == truncations.shape == (3,)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_a_reward_compares_the_scene_before_with_the_scene_after() -> None:
    env = environment(ALONE)
    env.reset()
    _, rewards, *_ = env.step(idle(env))
    np.testing.assert_allclose(rewards, 30.0 / 3)


def test_an_episode_whose_time_is_over_is_truncated_and_not_terminated() -> None:
    env = environment(ALONE)
    env.reset()
    for _ in range(59):
        _, _, terminations, truncations, infos = env.step(idle(env))
        assert not terminations.any()
        assert not truncations.any()
        assert "final_info" not in infos
    _, _, terminations, truncations, infos = env.step(idle(env))
    assert truncations.all()
    assert not terminations.any()
    assert (infos["final_info"]["ending"] == TIME).all()
    assert (infos["final_info"]["steps"] == 60).all()
    np.testing.assert_allclose(infos["final_info"]["episode_return"], 600.0)


def test_leaving_the_road_terminates_that_episode_only() -> None:
    env = environment(ALONE)
    env.reset()
    env.simulation.scene.y[2] = 16.0
    locate(env.simulation.scene, np.array([2]))
    _, _, terminations, truncations, infos = env.step(idle(env))
    assert terminations.tolist() == [False, False, True, False]
    assert not truncations.any()
    assert infos["final_info"]["ending"][2] == OFF_ROAD
    assert infos["_final_info"].tolist() == terminations.tolist()


def test_a_crash_terminates() -> None:
    env = environment(SceneSettings(traffic_vehicles=1, ego_slots=1), scenes=1)
    env.reset()
    scene = env.simulation.scene
    scene.x[0], scene.y[0], scene.speed[0] = (100.0, 107.0), 4.0, (33.0, 22.0)
    locate(scene, np.array([0]))
    _, _, terminations, _, infos = env.step(idle(env))
    assert terminations.all()
    assert infos["final_info"]["ending"][0] == REAR_END


def test_an_ended_episode_restarts_within_the_step_and_leaves_its_last_observation() -> None:
    env = environment(ALONE, scenes=1)
    first, _ = env.reset(seed=3)
    for _ in range(60):
        before, _, _, _, infos = env.step(np.array([FASTER]))
    last = infos["final_obs"][0]
    assert last[0, 3] == pytest.approx(33.0 / 66.0, abs=1e-3)  # where FASTER has led to
    assert before[0, 0, 3] == first[0, 0, 3] == np.float32(30.0 / 66.0)
    assert env.simulation.steps[0] == 0


def test_the_kth_episode_to_start_has_the_kth_seed() -> None:
    env = environment(SceneSettings(duration_s=1.0), scenes=3, first_seed=2**40)
    env.reset()
    assert env.simulation.seeds.tolist() == [2**40, 2**40 + 1, 2**40 + 2]
    for _ in range(3):
        env.step(idle(env))
    assert env.simulation.seeds.tolist() == [2**40 + 3, 2**40 + 4, 2**40 + 5]
    env.reset(seed=5)
    assert env.simulation.seeds.tolist() == [5, 6, 7]


def test_a_restored_environment_goes_on_as_if_nothing_had_happened() -> None:
    env = environment(SceneSettings(), scenes=6)
    env.reset(seed=11)
    random_steps(env, 0, 100)
    later = environment(SceneSettings(), scenes=6)
    later.reset(seed=99)
    observations = later.set_state(env.get_state())
    assert len(set(env.simulation.steps)) > 1  # episodes are in different steps
    expected, found = random_steps(env, 1, 70), random_steps(later, 1, 70)
    np.testing.assert_array_equal(observations[:, 0, 0], 1.0)
    for one, other in zip(expected, found, strict=True):
        for value, same in zip(one, other, strict=True):
            np.testing.assert_array_equal(value, same)


def test_episodes_start_in_the_scenes_of_a_state() -> None:
    env = environment(SceneSettings(), scenes=2)
    env.reset(seed=11)
    random_steps(env, 0, 5)
    state = env.get_state().scenes.take(np.array([1, 1, 1, 0]))
    many = environment(SceneSettings(), scenes=4)
    observations, _ = many.reset(options={"state": state})
    np.testing.assert_array_equal(observations[0], observations[2])
    _, rewards, *_ = many.step(idle(many))
    np.testing.assert_array_equal(rewards[[1, 3]], env.step(idle(env))[1][::-1])


def test_gymnasiums_own_wrappers_count_the_same_returns() -> None:
    env = environment(SceneSettings())
    wrapped = DictInfoToList(RecordEpisodeStatistics(env))
    wrapped.reset(seed=1)
    counted = []
    for _ in range(120):
        _, _, terminations, truncations, infos = wrapped.step(idle(env))
        for row in np.nonzero(terminations | truncations)[0]:
            own = infos[row]["final_info"]["episode_return"]
            counted.append((own, infos[row]["episode"]["r"]))
    assert len(counted) >= 8
    np.testing.assert_allclose(*np.transpose(counted))


@pytest.mark.parametrize("wrong", [[1, 1], [1.0] * 4, None, [[1], [1, 2]], [1, 1, 1, 5], "abcd"])
def test_wrong_actions_of_any_kind_are_an_error_of_the_user(wrong: Any) -> None:
    env = environment(ALONE)
    env.reset()
    with pytest.raises(InputError, match=r"expected integers of shape|action 5|inhomogeneous"):
        env.step(wrong)


def test_options_that_reset_does_not_know_are_rejected() -> None:
    with pytest.raises(InputError, match="takes the options 'reset_mask' and 'state', got speed"):
        environment(ALONE).reset(options={"speed": 3})


def test_the_mask_of_the_next_step_is_that_of_the_episode_that_starts() -> None:
    env = environment(ALONE)
    _, infos = env.reset()
    for _ in range(61):
        lane = env.simulation.scene.lane[env.simulation.ego_vehicles]
        assert infos["_action_mask"].all()
        assert infos["action_mask"][:, LANE_LEFT].tolist() == (lane > 0).tolist()
        assert infos["action_mask"].tolist() == env.action_masks().astype(int).tolist()
        *_, infos = env.step(idle(env))
