"""Double DQN (van Hasselt et al. 2016), which can be regularised towards human driving.

With a prior p(a | s), the probabilities of human drivers' actions, the return of a policy pi is
less by lambda times the Kullback-Leibler divergence of pi from p at each decision (Jacob et al.
2022, piKL). The best policy is then pi ~ p exp(Q / lambda), and the value of an observation is its
mean of Q - lambda log(pi / p). Without a prior, it is the largest Q. `DoubleDQN.step` is the loop.
"""

import json
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import Linear, Sequential
from torch.nn.functional import log_softmax, mse_loss

from charms_agents.training.episodes import Episodes
from charms_agents.training.hyperparameters import Hyperparameters
from charms_agents.training.network import (
    Arrays,
    load_state,
    side_by_side,
    state_arrays,
    untrained,
    widened,
)
from charms_agents.training.standardisation import folded, standardise
from charms_bench.world.actions import ACTIONS
from charms_bench.world.scene import Observations

Returns = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]
_COUNTERS = ("steps", "gradient_steps", "stored", "exploration", "loss")


class DoubleDQN:
    """The online network chooses actions, and the target network values them.

    All random numbers but the initial weights come from one generator, so that `arrays` holds the
    complete state.

    Args:
        episodes: B environments; their observations are flattened.
        seed: Seed of the initial weights, of exploration and of replay.
        total: Number of steps of the training, which the schedules follow.
        prior: Gives the logits of the actions that people take, from observations in the form that
            the network takes; it has as many layers. None leaves the policy to the values alone.
        actions: A, the number of the actions.
        given: (B, G) what the network is given in each environment beside its observations, such
            as the style in which it drives; by default, nothing.
    """

    def __init__(
        self,
        episodes: Episodes,
        h: Hyperparameters,
        seed: int,
        total: int,
        prior: Sequential | None = None,
        actions: int = len(ACTIONS),
        given: NDArray[np.float32] | None = None,
    ) -> None:
        self.h, self.total, self._episodes, self._actions = h, total, episodes, actions
        given = np.zeros((h.scenes, 0), np.float32) if given is None else given
        self._given = torch.from_numpy(given)
        self.prior = None if prior is None else widened(prior, given.shape[1])
        self.observed = episodes.reset()
        """(B, rows, columns) the last observations."""
        self.rng = np.random.default_rng([seed, 2])
        inputs = self.observed[0].size + given.shape[1]
        self.online = untrained(h.hidden_layers, seed, inputs, actions)
        self.target = deepcopy(self.online)
        self.optimizer = torch.optim.Adam(self.online.parameters(), fused=True)
        self.steps = self.gradient_steps = self.stored = 0
        self.exploration = 0.0
        """Probability of a random action."""
        self.loss = float("nan")
        """Mean loss of the last gradient steps."""
        shape = (max(h.replay_buffer // h.scenes, 1), h.scenes)
        seen = np.zeros((*shape, *self.observed.shape[1:]), dtype=np.float32)
        self.replay: Arrays = {
            "observations": seen,
            "following": seen.copy(),
            "actions": np.zeros(shape, dtype=np.int64),
            "rewards": np.zeros(shape, dtype=np.float32),
            "failed": np.zeros(shape, dtype=np.bool_),
            "ended": np.zeros(shape, dtype=np.bool_),
        }
        """[rows, B] the last steps; of `stored` rows, each overwrites the oldest."""

    def step(self) -> list[dict[str, Any]]:
        """Takes a step in each environment and learns; returns facts about ended episodes."""
        h, actions = self.h, self.actions()
        step = self._episodes.step(actions)
        self.remember(self.observed, step.following, actions, step.rewards, step.failed, step.ended)
        self.observed = step.observed
        self.steps += h.scenes
        if self.steps % h.target_update_steps == 0:
            self._update_target()
        self.exploration = h.exploration_at(self._remaining)
        if self.steps > h.learning_starts:
            self.learn(h.scenes // h.steps_per_gradient_step)
        return step.facts

    def actions(self) -> NDArray[np.int64]:
        """The actions (B,): random before learning starts, then with a chance for each of them.

        With a prior, they are drawn from the policy, and random ones are not needed at the start.
        """
        actions = self.rng.integers(self._actions, size=self.h.scenes)
        if self.prior is not None:
            logits = self.preferences(self.observed, self._given)
            chosen = (logits + self.rng.gumbel(size=logits.shape)).argmax(axis=1)
        elif self.steps >= self.h.learning_starts:
            chosen = self.preferences(self.observed, self._given).argmax(axis=1)
        else:
            return actions
        return np.where(self.rng.random(self.h.scenes) < self.exploration, actions, chosen)

    def remember(self, *parts: NDArray[Any]) -> None:
        """Writes a row of the replay buffer, its parts in the order of `replay`."""
        for array, part in zip(self.replay.values(), parts, strict=True):
            array[self.stored % len(array)] = part
        self.stored += 1

    @property
    def remembered(self) -> Arrays:
        """The rows of the replay buffer that have been written."""
        return {name: array[: self.stored] for name, array in self.replay.items()}

    def learn(self, gradient_steps: int) -> None:
        """Takes gradient steps on the squared error to y_t, eq. 3 of the paper."""
        if self.h.starts_at_mean_reward and not self.gradient_steps:
            self.raise_values()
        size, shape = len(self.remembered["actions"]), (gradient_steps, self.h.batch_size)
        rows = self.rng.integers(size, size=shape)
        envs = self.rng.integers(self.h.scenes, size=shape)
        returns, discounts, last = self.returns(rows, envs)
        observations = self._seen(self.replay["observations"][rows, envs], self._given[envs])
        following = self._seen(self.replay["following"][last, envs], self._given[envs])
        actions = torch.from_numpy(self.replay["actions"][rows, envs])[..., None]
        rewards, factors = torch.from_numpy(returns), torch.from_numpy(discounts)
        parameters = list(self.online.parameters())
        for group in self.optimizer.param_groups:
            group["lr"] = self.h.learning_rate_at(self._remaining)
        with torch.no_grad():  # the target network does not change in between
            next_values = self.target(following)
            log_prior = None if self.prior is None else log_softmax(self.prior(following), -1)
        losses = np.empty(gradient_steps)
        for k in range(gradient_steps):
            with torch.no_grad():
                online = self.online(following[k])
                if log_prior is None:
                    best = online.argmax(dim=1, keepdim=True)
                    value = next_values[k].gather(1, best)[:, 0]
                else:
                    value = regularised(online, next_values[k], log_prior[k], self.h.prior_weight)
                wanted = rewards[k] + factors[k] * value
            self.optimizer.zero_grad()
            values = self.online(observations[k]).gather(1, actions[k])[:, 0]
            mse_loss(values, wanted).backward()  # type: ignore[no-untyped-call]  # of torch
            losses[k] = (values.detach() - wanted).square().mean()
            torch.nn.utils.clip_grad_norm_(parameters, self.h.max_gradient_norm)
            self.optimizer.step()
        self.gradient_steps += gradient_steps
        self.loss = float(losses.mean())

    def returns(self, rows: NDArray[Any], envs: NDArray[Any]) -> Returns:
        """The parts of y_t, eq. 3 of the paper, from steps in the replay buffer, of any one shape.

        A return adds up `return_steps` rewards, or fewer if the episode or the buffer ends before.

        Returns:
            The sums of discounted rewards; the discounts of the values after the last steps, 0
            after a failure; and the rows of the last steps in the buffer.
        """
        replay, count = self.replay, len(self.replay["rewards"])
        newest = (self.stored - 1) % count
        last, rewards = rows, replay["rewards"][rows, envs]
        discounts = np.full(rows.shape, self.h.discount, dtype=np.float32)
        for _ in range(1, self.h.return_steps):
            goes_on = ~replay["ended"][last, envs] & (last != newest)
            last = np.where(goes_on, (last + 1) % count, last)
            rewards += np.where(goes_on, discounts * replay["rewards"][last, envs], 0)
            discounts *= np.where(goes_on, np.float32(self.h.discount), 1)
        # An episode that ended by time could have continued, so its last observation has a value.
        discounts[replay["failed"][last, envs]] = 0
        return rewards, discounts, last

    def raise_values(self) -> None:
        """Adds the discounted sum of mean rewards to the values of both networks."""
        rewards = self.remembered["rewards"][~self.remembered["failed"]]
        with torch.no_grad():
            for network in (self.online, self.target):
                last = network[-1]
                assert isinstance(last, Linear)
                last.bias.add_(float(rewards.mean()) / (1 - self.h.discount))

    @torch.no_grad()
    def _update_target(self) -> None:
        rate = self.h.target_update_rate
        pairs = zip(self.target.parameters(), self.online.parameters(), strict=True)
        for target, online in pairs:
            target.mul_(1 - rate).add_(online, alpha=rate)

    @property
    def _remaining(self) -> float:
        """The proportion of all steps that remains."""
        return 1 - self.steps / self.total

    @torch.no_grad()
    def preferences(self, observations: Observations, given: Tensor) -> NDArray[np.float32]:
        """The values (B, A) of the actions, or with a prior, the logits of the policy."""
        seen = self._seen(observations, given)
        found = self.online(seen)
        if self.prior is not None:
            found = found / self.h.prior_weight + self.prior(seen)
        return np.asarray(found.numpy())

    @property
    def network(self) -> Sequential:
        """The online network, made to take plain observations, and then what it is given.

        With a prior, its outputs are the logits of the policy.
        """
        network = self.online
        if self.prior is not None:
            network = side_by_side(network, 1 / self.h.prior_weight, self.prior)
        return folded(network, self._given.shape[1]) if self.h.standardised else network

    def _seen(self, observations: Observations, given: Tensor) -> Tensor:
        """What the networks take of observations (..., rows, columns) and `given` (..., G)."""
        flat = torch.from_numpy(observations).flatten(-2)
        seen = standardise(flat) if self.h.standardised else flat
        return torch.cat([seen, given], dim=-1) if given.shape[-1] else seen

    @property
    def _networks(self) -> dict[str, Sequential]:
        return {"online": self.online, "target": self.target}

    def arrays(self) -> Arrays:
        """Everything that further training depends on except the environment, as plain arrays."""
        arrays = state_arrays(self._networks, self.optimizer)
        arrays |= {f"replay/{name}": array for name, array in self.remembered.items()}
        counters = {name: getattr(self, name) for name in _COUNTERS}
        numbers = {"counters": counters, "rng": self.rng.bit_generator.state}
        return arrays | {"numbers": np.array(json.dumps(numbers))}

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same configuration."""
        load_state(self._networks, self.optimizer, arrays)
        numbers = json.loads(str(arrays["numbers"]))
        for name in _COUNTERS:
            setattr(self, name, numbers["counters"][name])
        for name, array in self.remembered.items():
            array[:] = arrays[f"replay/{name}"]
        self.rng.bit_generator.state = numbers["rng"]


def regularised(online: Tensor, target: Tensor, log_prior: Tensor, weight: float) -> Tensor:
    """The values (M,) of observations under the policy that a prior regularises.

    Args:
        online: (M, A) the values that decide the policy.
        target: (M, A) the values of the actions.
        log_prior: (M, A) logarithms of the probabilities of the prior.
        weight: lambda.
    """
    log_policy = log_softmax(online / weight + log_prior, dim=1)
    regret = target - weight * (log_policy - log_prior)
    return (log_policy.exp() * regret).sum(dim=1)
