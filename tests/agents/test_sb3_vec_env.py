"""Episodes as Stable-Baselines3 sees them."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from charms_agents.training.rewards import StyleReward, Weights
from charms_agents.training.vec_env import EpisodesVecEnv
from handmade_scene import Idle
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from charms_bench.engine.kernels import locate
from charms_bench.engine.simulation import OFF_ROAD, TIME
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import IDLE
from charms_bench.world.scene import SceneSettings

WEIGHTS = Weights(safety=1.0, efficiency=1.0, comfort=0.0)


def environment(scenes: int, duration_s: float = 1.0) -> EpisodesVecEnv:
    settings = SceneSettings(traffic_vehicles=2, ego_slots=1, duration_s=duration_s)
    reward = StyleReward(WEIGHTS, 0.0)
    agents = {"idle": Idle()}
    return EpisodesVecEnv(HighwayVectorEnv(settings, scenes, OneAgent("idle"), agents, reward))


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
    from charms_agents.training.double_dqn import DoubleDQN

    agent = DoubleDQN(environment(4), 0, learning_starts=100, buffer_size=400)
    agent.learn(40, log_interval=None)  # type: ignore[arg-type]  # which it allows
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
