"""Double DQN: its target by hand, its rates in steps, its exploration."""

from typing import Any

import numpy as np
import pytest
import torch
from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.episodes import Episodes
from charms_agents.training.hyperparameters import Hyperparameters
from charms_agents.training.rewards import StyleReward, Weights
from handmade_scene import Idle

from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.scene import SceneSettings


def double_dqn(scenes: int = 2, total: int = 1000, **hyperparameters: Any) -> DoubleDQN:
    settings = SceneSettings(traffic_vehicles=1, ego_slots=1)
    reward = StyleReward(Weights(safety=1.0, efficiency=1.0, comfort=1.0), 0.0)
    made = HighwayVectorEnv(settings, scenes, OneAgent("idle"), {"idle": Idle()}, reward)
    given = {"replay_buffer": 1000, "hidden_layers": (8,), **hyperparameters}
    return DoubleDQN(Episodes([made]), Hyperparameters(scenes=scenes, **given), 0, total)


def always_value(network: Any, values: tuple[float, ...]) -> None:
    """Makes a network without hidden layers give every observation the same values."""
    with torch.no_grad():
        network[0].weight.zero_()
        network[0].bias.copy_(torch.tensor(values))


def remember(agent: DoubleDQN, rewards: Any, failed: bool = False, ended: bool = False) -> None:
    """Writes a step of both environments, with action 0, to the replay buffer."""
    nothing, actions = np.zeros((2, 7, 5), dtype=np.float32), np.zeros(2, dtype=np.int64)
    parts = (np.broadcast_to(each, 2) for each in (rewards, failed, ended))
    agent.remember(nothing, nothing, actions, *parts)


@pytest.mark.parametrize(
    ("failed", "ended", "expected"),
    [
        # The online network prefers action 1, which the target network values at 2 (and action 0
        # at 10, which is what DQN without the second network would take): y = 1 + 0.5 * 2 = 2,
        # and the action taken, 0, is valued at 1.
        (False, False, (2.0 - 1.0) ** 2),
        # A failure ends it: y = 1.
        (True, True, 0.0),
        # The end of the time does not.
        (False, True, (2.0 - 1.0) ** 2),
    ],
)
def test_the_online_network_chooses_and_the_target_network_values(
    failed: bool, ended: bool, expected: float
) -> None:
    agent = double_dqn(discount=0.5, hidden_layers=(), batch_size=4)
    always_value(agent.online, (1.0, 5.0, 0.0, 0.0, 0.0))
    always_value(agent.target, (10.0, 2.0, 0.0, 0.0, 0.0))
    remember(agent, 1.0, failed, ended)
    agent.learn(1)
    assert agent.loss == pytest.approx(expected)


LARGE = {"replay_buffer": 400, "target_update_steps": 400}
"""Multiples of 400 scenes."""


def test_rates_count_the_steps_of_all_environments_together() -> None:
    agent = double_dqn(scenes=10, learning_starts=20, target_update_steps=100)
    copied_at = []
    while agent.steps < 410:
        before = agent.target[0].weight.clone()
        agent.step()
        if not torch.equal(before, agent.target[0].weight):
            copied_at.append(agent.steps)
    assert agent.gradient_steps == (410 - 20) / 2
    assert copied_at == [100, 200, 300, 400]


def test_each_environment_explores_by_itself() -> None:
    agent = double_dqn(scenes=400, learning_starts=0, hidden_layers=(), **LARGE)
    always_value(agent.online, (0.0, 0.0, 1.0, 0.0, 0.0))
    agent.exploration = 0.5
    actions = agent.actions()
    # Half of all explore, a fifth of them by what is greedy: 240 +- 10 stay greedy.
    assert 200 < (actions == 2).sum() < 280
    assert set(actions) == {0, 1, 2, 3, 4}


def test_before_learning_starts_every_action_is_random() -> None:
    agent = double_dqn(scenes=400, learning_starts=1, **LARGE)
    assert np.bincount(agent.actions(), minlength=5).min() > 50


def recorded(*rewards: float, ended: int = -1, timeout: bool = False, rows: int = 500) -> DoubleDQN:
    """An agent whose targets add up three rewards, half as much each; the step `ended` ends."""
    agent = double_dqn(discount=0.5, return_steps=3, replay_buffer=2 * rows)
    for k, reward in enumerate(rewards):
        remember(agent, (reward, 0.0), k == ended and not timeout, k == ended)
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
    agent = double_dqn(total=8, learning_rate=8.0, learning_rate_decay=1.0, learning_starts=0)
    agent.step()
    agent.steps = 6
    agent.learn(1)
    assert agent.optimizer.param_groups[0]["lr"] == 2.0


def test_exploration_falls_over_its_fraction_of_the_steps() -> None:
    agent = double_dqn(total=16, exploration_final=0.2, exploration_share=0.5)
    fallen = []
    while agent.steps < 10:
        agent.step()
        fallen.append(agent.exploration)
    # From 1 to 0.2 in the first 8 of 16 steps, two at a time.
    assert fallen == pytest.approx([0.8, 0.6, 0.4, 0.2, 0.2])


def test_a_standardised_networks_values_are_those_of_its_exported_network() -> None:
    agent = double_dqn(standardised=True)
    observations = np.random.default_rng(0).normal(size=(50, 7, 5)).astype(np.float32)
    observations[:, 0, :2] = 1.0
    with torch.no_grad():
        exported = agent.network(torch.from_numpy(observations).flatten(1)).numpy()
        plain = agent.online(torch.from_numpy(observations).flatten(1)).numpy()
    values = agent.preferences(observations, agent._given)
    np.testing.assert_allclose(exported, values, rtol=1e-4, atol=1e-5)
    assert not np.allclose(plain, exported)


def test_values_can_start_at_the_discounted_sum_of_mean_rewards() -> None:
    # In the first environment, the rewards are 1, 2 and, in the step that fails, -10; in the
    # second they are 0. Without failures the mean is (1 + 2 + 0 + 0) / 4, twice that at gamma 0.5.
    agent = recorded(1.0, 2.0, -10.0, ended=2)
    for parameter in agent.online.parameters():
        torch.nn.init.zeros_(parameter)
    agent.raise_values()
    assert agent.online[-1].bias.tolist() == [1.5] * 5
