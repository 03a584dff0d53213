"""Episodes as Stable-Baselines3 sees them."""

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from stable_baselines3 import DQN, PPO, SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.vec_env import VecMonitor

import charms_bench.envs  # noqa: F401  # registers the environments
from charms_bench.engine.endings import OFF_ROAD, TIME
from charms_bench.engine.neighbours import locate
from charms_bench.envs.ego_env import ego_vector_env
from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.errors import InputError
from charms_bench.world.actions import IDLE

SHORT = {"traffic_vehicles": 2, "ego_slots": 1, "duration_s": 1.0, "traffic": "level_0"}


def environment(scenes: int, render_mode: str | None = None) -> EpisodesVecEnv:
    return EpisodesVecEnv(ego_vector_env(scenes, render_mode=render_mode, **SHORT))


def test_an_ended_episode_leaves_its_last_observation_and_why_it_ended() -> None:
    env = environment(2)
    first = env.reset()
    for _ in range(2):
        env.step(np.full(2, IDLE))
    scene = env.episodes.simulation.scene
    scene.y[1, scene.ego[1]] = 16.0
    locate(scene, np.array([1]))
    observations, _, dones, infos = env.step(np.full(2, IDLE))
    assert dones.tolist() == [True, True]
    assert [info["TimeLimit.truncated"] for info in infos] == [True, False]
    assert [info["final_info"]["ending"] for info in infos] == [TIME, OFF_ROAD]
    assert infos[1]["terminal_observation"][0, 2] > 1.0  # 16 m from the leftmost lane, of 12
    assert (observations[:, 0, 2] < 1.0).all()
    assert first.shape == observations.shape


def test_the_replay_buffer_tells_the_end_of_time_from_a_failure() -> None:
    agent = DQN("MlpPolicy", environment(4), learning_starts=100, buffer_size=400, device="cpu")
    agent.learn(40)
    buffer = agent.replay_buffer
    assert buffer is not None
    last = np.arange(10) % 3 == 2  # of episodes of three decisions
    assert (buffer.dones[:10] == last[:, None]).all()
    assert (buffer.timeouts[:10] == last[:, None]).all()


def test_other_algorithms_and_wrappers_take_it() -> None:
    agent = PPO("MlpPolicy", VecMonitor(environment(4)), n_steps=8, batch_size=16, device="cpu")
    agent.learn(64)
    assert agent.ep_info_buffer is not None
    assert {info["l"] for info in agent.ep_info_buffer} == {3}


def test_what_is_drawn_of_several_episodes_is_one_picture() -> None:
    env = environment(4, "rgb_array")
    env.reset()
    frames = env.episodes.render()
    tiles = env.render()
    assert env.metadata["render_fps"] == 3
    height, width, _ = frames[0].shape
    assert tiles.shape == (2 * height, 2 * width, 3)
    np.testing.assert_array_equal(tiles[height:, :width], frames[2])


def test_options_that_would_have_no_effect_are_named() -> None:
    env = environment(2)
    with pytest.warns(UserWarning, match="set_options has no effect"):
        env.set_options({"state": 1})
    env.set_options()
    env.reset()


def test_it_takes_no_environment_whose_episodes_restart_later() -> None:
    with pytest.raises(InputError, match=r"autoreset_mode is .*NEXT_STEP.*; expected 'SameStep'"):
        EpisodesVecEnv(ego_vector_env(2, autoreset_mode="NextStep", **SHORT))


def test_a_window_shows_what_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = environment(2, "human")
    env.reset()
    assert env.render() is None
    env.close()


def test_training_is_evaluated_by_a_callback() -> None:
    callback = EvalCallback(VecMonitor(environment(2)), eval_freq=8, n_eval_episodes=4, verbose=0)
    agent = PPO("MlpPolicy", VecMonitor(environment(4)), n_steps=8, batch_size=16, device="cpu")
    agent.learn(64, callback)
    assert callback.n_calls == 16
    # Highway-env's rewards lie in [0, 1], and an episode has at most three decisions.
    assert 0.0 < callback.best_mean_reward <= 3.0


def test_maskable_algorithms_get_the_masks_by_the_method_that_they_ask_for() -> None:
    env = VecMonitor(environment(3))
    env.reset()
    assert env.get_attr("action_masks")
    asked = np.stack(env.env_method("action_masks"))
    assert asked.tolist() == env.venv.episodes.action_masks().tolist()
    assert len(env.env_method("action_masks", indices=[1])) == 1


def test_hindsight_asks_many_car_parks_for_the_rewards_of_goals() -> None:
    park = gymnasium.make_vec("charms_bench/parking-v0", num_envs=3, config={"duration": 4})
    env = EpisodesVecEnv(park)
    agent = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=90,
        batch_size=32,
        policy_kwargs={"net_arch": [16]},
        device="cpu",
    )
    agent.learn(150)
    buffer = agent.replay_buffer
    assert isinstance(buffer, HerReplayBuffer)
    found = buffer.sample(64)
    goals = found.next_observations["achieved_goal"], found.observations["desired_goal"]
    expected = park.unwrapped.compute_reward(*(each.numpy() for each in goals))
    np.testing.assert_allclose(found.rewards[:, 0], expected, rtol=0, atol=1e-6)
    assert set(found.dones.unique().tolist()) <= {0.0, 1.0}
