"""Double DQN: its target by hand, its rates in steps, its exploration."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.rewards import StyleReward, Weights
from charms_agents.training.vec_env import EpisodesVecEnv
from handmade_scene import Idle
from stable_baselines3.common.callbacks import BaseCallback

from charms_bench.scene import SceneSettings
from charms_bench.traffic import OneAgent
from charms_bench.vector_env import HighwayVectorEnv


def double_dqn(scenes: int = 2, **arguments: Any) -> DoubleDQN:
    settings = SceneSettings(traffic_vehicles=1, ego_slots=1)
    reward = StyleReward(Weights(safety=1.0, efficiency=1.0, comfort=1.0), "egoistic")
    episodes = HighwayVectorEnv(settings, scenes, OneAgent("idle"), {"idle": Idle()}, reward)
    arguments = {"buffer_size": 1000, "policy_kwargs": {"net_arch": [8]}, **arguments}
    return DoubleDQN(EpisodesVecEnv(episodes), 0, device="cpu", **arguments)


def always_value(network: Any, values: tuple[float, ...]) -> None:
    """Makes a network without hidden layers give every observation the same values."""
    with torch.no_grad():
        network.q_net[0].weight.zero_()
        network.q_net[0].bias.copy_(torch.tensor(values))


@pytest.mark.parametrize(
    ("done", "timeout", "expected"),
    [
        # The online network prefers action 1, which the target network values at 2 (and action 0
        # at 10, which is what DQN without the second network would take): y = 1 + 0.5 * 2 = 2,
        # and the action taken, 0, is valued at 1.
        (False, False, (2.0 - 1.0) ** 2),
        # A failure ends it: y = 1.
        (True, False, 0.0),
        # The end of the time does not.
        (True, True, (2.0 - 1.0) ** 2),
    ],
)
def test_the_online_network_chooses_and_the_target_network_values(
    done: bool, timeout: bool, expected: float
) -> None:
    agent = double_dqn(gamma=0.5, policy_kwargs={"net_arch": []})
    always_value(agent.q_net, (1.0, 5.0, 0.0, 0.0, 0.0))
    always_value(agent.q_net_target, (10.0, 2.0, 0.0, 0.0, 0.0))
    observations = np.zeros((2, 7, 5), dtype=np.float32)
    buffer = agent.replay_buffer
    assert buffer is not None
    infos = [{"TimeLimit.truncated": timeout}] * 2
    buffer.add(observations, observations, np.zeros(2), np.ones(2), np.full(2, done), infos)
    agent.train(gradient_steps=1, batch_size=4)
    assert agent.loss == pytest.approx(expected)


class Rates(BaseCallback):
    """Notes the gradient steps and the steps at which the target network has changed."""

    def __init__(self) -> None:
        super().__init__()
        self.copied_at: list[int] = []
        self._last: Any = None

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, DoubleDQN)
        weights = self.model.q_net_target.q_net[0].weight.clone()
        if self._last is not None and not torch.equal(weights, self._last):
            self.copied_at.append(self.model.num_timesteps)
        self._last = weights

    def _on_step(self) -> bool:
        return True


def test_rates_count_the_steps_of_all_environments_together() -> None:
    agent = double_dqn(
        scenes=10,
        learning_starts=100,
        train_freq=(1, "step"),
        gradient_steps=5,
        target_update_interval=500,
    )
    rates = Rates()
    agent.learn(2100, callback=rates, log_interval=None)  # type: ignore[arg-type]
    assert agent._n_updates == (2100 - 100) / 2
    assert rates.copied_at == [500, 1000, 1500, 2000]


def test_each_environment_explores_by_itself() -> None:
    agent = double_dqn(scenes=400, learning_starts=0, policy_kwargs={"net_arch": []})
    always_value(agent.q_net, (0.0, 0.0, 1.0, 0.0, 0.0))
    agent._last_obs = np.zeros((400, 7, 5), dtype=np.float32)
    agent.exploration_rate = 0.5
    actions, _ = agent._sample_action(0, n_envs=400)
    # Half of all explore, a fifth of them by what is greedy: 240 +- 10 stay greedy.
    assert 200 < (actions == 2).sum() < 280
    assert set(actions) == {0, 1, 2, 3, 4}


def test_before_learning_starts_every_action_is_random() -> None:
    agent = double_dqn(scenes=400, learning_starts=1)
    actions, _ = agent._sample_action(1, n_envs=400)
    assert np.bincount(actions, minlength=5).min() > 50
