"""Values and policies that a prior regularises: closed forms, and what an optimiser finds."""

import math

import numpy as np
import pytest
import torch
from charms_agents.training.double_dqn import DoubleDQN, regularised
from charms_agents.training.episodes import Episodes
from charms_agents.training.hyperparameters import Hyperparameters
from charms_agents.training.network import network_of
from charms_agents.training.own_traffic import OwnTraffic
from charms_agents.training.rewards import StyleReward, Weights
from handmade_scene import Idle
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.special import logsumexp, rel_entr, softmax

from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import DEFAULT_ACTIONS
from charms_bench.world.observations import neighbours
from charms_bench.world.scene import SceneSettings

Array = np.ndarray
SCENES = 1_000


def values(rows: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(0.0, 3.0, size=(rows, 5))


def log_priors(rows: int, seed: int = 1) -> Array:
    logits = np.random.default_rng(seed).normal(0.0, 2.0, size=(rows, 5))
    return np.asarray(np.log(softmax(logits, axis=1)))


def regularised_values(online: Array, target: Array, log_prior: Array, weight: float) -> Array:
    given_ = (torch.from_numpy(each) for each in (online, target, log_prior))
    return np.asarray(regularised(*given_, weight).numpy())


@settings(derandomize=True, deadline=None, max_examples=50)
@given(seed=st.integers(0, 1000), weight=st.floats(0.05, 50.0))
def test_with_one_network_a_value_is_the_closed_form_of_pikl(seed: int, weight: float) -> None:
    q, log_prior = values(20, seed), log_priors(20, seed + 1)
    expected = weight * logsumexp(q / weight + log_prior, axis=1)
    found = regularised_values(q, q, log_prior, weight)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_the_online_network_chooses_the_policy_that_the_target_network_values() -> None:
    online, target, log_prior = values(20, 2), values(20, 3), log_priors(20)
    policy, prior = softmax(online / 0.7 + log_prior, axis=1), np.exp(log_prior)
    expected = (policy * target).sum(axis=1) - 0.7 * rel_entr(policy, prior).sum(axis=1)
    found = regularised_values(online, target, log_prior, 0.7)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def agent_of(q: Array, log_prior: Array, weight: float, discount: float = 0.5) -> DoubleDQN:
    """An agent whose networks and whose prior give every observation the same numbers."""
    scene = SceneSettings(traffic_vehicles=1, ego_slots=1)
    reward = StyleReward(Weights(safety=1.0, efficiency=1.0, comfort=1.0), 0.0)
    made = HighwayVectorEnv(scene, SCENES, OneAgent("idle"), {"idle": Idle()}, reward)
    h = Hyperparameters(
        scenes=SCENES, replay_buffer=SCENES, target_update_steps=SCENES, batch_size=4,
        hidden_layers=(), discount=discount, standardised=True, prior_weight=weight,
    )  # fmt: skip
    agent = DoubleDQN(Episodes([made]), h, 0, 10 * SCENES, constant(log_prior))
    for network in (agent.online, agent.target):
        network.load_state_dict(constant(q).state_dict())
    return agent


def constant(numbers: Array) -> "torch.nn.Sequential":
    return network_of([(np.zeros((5, 35), np.float32), numbers.astype(np.float32))])


def test_the_policy_maximises_the_value_less_lambda_times_the_divergence() -> None:
    q, log_prior, weight = np.array([1.0, 0.0, -2.0, 0.5, 0.3]), log_priors(1)[0], 0.4

    def lost(logits: Array) -> float:
        policy = softmax(logits)
        return float(weight * rel_entr(policy, np.exp(log_prior)).sum() - policy @ q)

    best = minimize(lost, np.zeros(5), method="BFGS", options={"gtol": 1e-9})
    agent = agent_of(q, log_prior, weight)
    logits = agent.preferences(agent.observed[:1], agent._given)[0]
    np.testing.assert_allclose(softmax(logits), softmax(best.x), atol=1e-4)
    found = regularised_values(q[None], q[None], log_prior[None], weight)
    assert found[0] == pytest.approx(-best.fun, abs=1e-6)


@pytest.mark.parametrize(
    ("weight", "expected"),
    [
        (1e6, softmax(log_priors(1)[0])),  # departing from the prior costs too much
        (1e-3, np.eye(5)[3]),  # the prior counts for nothing
    ],
)
def test_lambda_leads_from_the_largest_value_to_the_prior(weight: float, expected: Array) -> None:
    agent = agent_of(np.array([1.0, 0.0, -2.0, 1.5, 0.3]), log_priors(1)[0], weight)
    logits = agent.preferences(agent.observed[:1], agent._given)[0]
    np.testing.assert_allclose(softmax(logits), expected, atol=1e-4)


def test_actions_are_drawn_with_the_probabilities_of_the_policy() -> None:
    agent = agent_of(np.array([0.4, 0.0, -0.2, 0.1, 0.0]), log_priors(1, seed=4)[0], weight=0.5)
    own = OwnTraffic(neighbours, DEFAULT_ACTIONS, np.zeros((1, 0), np.float32))
    own.learner, count = agent, 20 * SCENES
    seen, noise = np.zeros((count, 7, 5), np.float32), np.random.default_rng(5).random((count, 6))
    in_traffic, _ = own.decide(seen, np.zeros((count, 1)), noise)
    expected = count * softmax(np.array([0.8, 0.0, -0.4, 0.2, 0.0]) + log_priors(1, 4)[0])
    for actions in (np.concatenate([agent.actions() for _ in range(20)]), in_traffic):
        drawn = np.bincount(actions, minlength=5)
        # Chi-squared with 4 degrees of freedom, p = 0.001.
        assert ((drawn - expected) ** 2 / expected).sum() < 18.47


def test_the_exported_network_gives_the_logits_of_the_policy() -> None:
    agent = agent_of(np.array([0.4, 0.0, -0.2, 0.1, 0.0]), log_priors(1)[0], weight=0.25)
    with torch.no_grad():
        exported = agent.network(torch.from_numpy(agent.observed[:9]).flatten(1)).numpy()
    logits = agent.preferences(agent.observed[:9], agent._given)
    np.testing.assert_allclose(exported, logits, rtol=1e-5, atol=1e-5)


def test_a_target_is_the_reward_and_the_regularised_value_after_it() -> None:
    weight, q = 0.5, np.array([0.5 * math.log(2), 0.0, 0.0, 0.0, 0.0])
    agent = agent_of(q, np.log(np.full(5, 0.2)), weight)
    nothing = np.zeros((SCENES, 7, 5), dtype=np.float32)
    over = np.zeros(SCENES, dtype=np.bool_)
    actions, rewards = np.ones(SCENES, dtype=np.int64), np.ones(SCENES)
    agent.remember(nothing, nothing, actions, rewards, over, over)
    agent.learn(1)
    # The value is 0.5 log((2 + 4) / 5), of which a half counts, and action 1 is valued at 0.
    assert agent.loss == pytest.approx((1.0 + 0.5 * 0.5 * math.log(6 / 5)) ** 2, rel=1e-6)
