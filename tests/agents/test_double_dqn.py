"""Double DQN: its target by hand, its rates in steps, its exploration."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.rewards import StyleReward, Weights
from handmade_scene import Idle
from stable_baselines3.common.callbacks import BaseCallback

from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.scene import SceneSettings


def double_dqn(scenes: int = 2, **arguments: Any) -> DoubleDQN:
    settings = SceneSettings(traffic_vehicles=1, ego_slots=1)
    reward = StyleReward(Weights(safety=1.0, efficiency=1.0, comfort=1.0), 0.0)
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
        learning_starts=20,
        train_freq=(1, "step"),
        gradient_steps=5,
        target_update_interval=100,
    )
    rates = Rates()
    agent.learn(420, callback=rates, log_interval=None)  # type: ignore[arg-type]  # which it allows
    assert agent._n_updates == (420 - 20) / 2
    assert rates.copied_at == [100, 200, 300, 400]


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


def recorded(*rewards: float, ended: int = -1, timeout: bool = False, rows: int = 500) -> DoubleDQN:
    """An agent whose targets add up three rewards, half as much each; the step `ended` ends."""
    agent = double_dqn(gamma=0.5, return_steps=3, buffer_size=2 * rows)
    buffer, nothing = agent.replay_buffer, np.zeros((2, 7, 5), dtype=np.float32)
    assert buffer is not None
    for k, reward in enumerate(rewards):
        done, infos = np.full(2, k == ended), [{"TimeLimit.truncated": timeout and k == ended}] * 2
        buffer.add(nothing, nothing, np.zeros(2), np.array([reward, 0.0]), done, infos)
    return agent


@pytest.mark.parametrize(
    ("arguments", "row", "expected"),
    [
        # 1 + 2 / 2 + 4 / 4, and an eighth of the value after row 2.
        ({}, 0, (3.0, 0.125, 2)),
        # Row 3 is the newest: 4 + 8 / 2, and a quarter of the value after it.
        ({}, 2, (8.0, 0.25, 3)),
        ({}, 3, (8.0, 0.5, 3)),
        # A failure in row 1: 1 + 2 / 2, and nothing comes after it.
        ({"ended": 1}, 0, (2.0, 0.0, 1)),
        # The end of the time in row 1: 1 + 2 / 2, and a quarter of the value it ends with.
        ({"ended": 1, "timeout": True}, 0, (2.0, 0.25, 1)),
        # What ends in the row before is another episode.
        ({"ended": 0}, 1, (6.0, 0.125, 3)),
    ],
)
def test_a_return_adds_up_rewards_until_the_episode_or_the_record_ends(
    arguments: dict[str, Any], row: int, expected: tuple[float, float, int]
) -> None:
    agent = recorded(1.0, 2.0, 4.0, 8.0, **arguments)
    rewards, discounts, last = agent.returns(np.array([row]), np.array([0]))
    assert (rewards[0], discounts[0], last[0]) == expected


def test_a_return_goes_on_at_the_start_of_a_full_buffer() -> None:
    agent = recorded(1.0, 2.0, 4.0, 8.0, 16.0, rows=4)  # the last one replaced the first
    rewards, discounts, last = agent.returns(np.array([2, 3]), np.array([0, 0]))
    np.testing.assert_array_equal(rewards, [4 + 8 / 2 + 16 / 4, 8 + 16 / 2])
    np.testing.assert_array_equal(discounts, [0.125, 0.25])
    np.testing.assert_array_equal(last, [0, 0])


def test_the_learning_rate_follows_its_schedule() -> None:
    agent = double_dqn(
        learning_starts=0, train_freq=(1, "step"), learning_rate=lambda remaining: 8 * remaining
    )
    agent.learn(8, log_interval=None)  # type: ignore[arg-type]  # which it allows
    agent.num_timesteps, agent._current_progress_remaining = 6, 0.25
    agent.train(gradient_steps=1)
    assert agent.policy.optimizer.param_groups[0]["lr"] == 2.0


def test_a_standardised_networks_values_are_those_of_its_exported_network() -> None:
    agent = double_dqn(standardised=True)
    observations = np.random.default_rng(0).normal(size=(50, 7, 5)).astype(np.float32)
    observations[:, 0, :2] = 1.0
    with torch.no_grad():
        exported = agent.network(torch.from_numpy(observations).flatten(1)).numpy()
        plain = agent.q_net.q_net(torch.from_numpy(observations).flatten(1)).numpy()
    np.testing.assert_allclose(exported, agent.values(observations), rtol=1e-4, atol=1e-5)
    assert not np.allclose(plain, exported)


def test_values_can_start_at_the_discounted_sum_of_mean_rewards() -> None:
    # In the first environment, the rewards are 1, 2 and, in the step that fails, -10; in the
    # second they are 0. Without failures the mean is (1 + 2 + 0 + 0) / 4, twice that at gamma 0.5.
    agent = recorded(1.0, 2.0, -10.0, ended=2)
    for parameter in agent.q_net.parameters():
        torch.nn.init.zeros_(parameter)
    agent._raise_values()
    assert agent.q_net.q_net[-1].bias.tolist() == [1.5] * 5
