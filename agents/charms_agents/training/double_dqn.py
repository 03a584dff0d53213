"""Double DQN (van Hasselt et al. 2016) on Stable-Baselines3's DQN."""

import json
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.vec_env import VecEnv
from torch.nn import Linear, Module, Sequential

from charms_agents.training.backpropagation import squared_error
from charms_agents.training.network import Arrays, load_state, state_arrays
from charms_agents.training.standardised import folded, standardise

Returns = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]
_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_COUNTERS = ("num_timesteps", "exploration_rate", "_n_calls", "_n_updates", "_episode_num")


class DoubleDQN(DQN):
    """DQN in which the online network chooses the action and the target network values it.

    It differs from its base class in three more ways. The loss is the squared error, as in the
    paper. Each environment decides by a draw of its own whether to explore; in the base class all
    environments explore in the same steps. After the initial weights, all random numbers come from
    one generator, so that `arrays` holds the complete state.

    Args:
        environment: The environment; its observations are flattened.
        seed: Seed of the initial weights, of exploration and of replay.
        return_steps: Number of rewards in y_t before the value (n-step returns).
        standardised: Whether the networks take standardised observations.
        starts_at_mean_reward: Whether the values of the untrained networks are raised to the mean
            reward of the steps before the first gradient step, divided by 1 - gamma.
        arguments: Further arguments of `DQN`.
    """

    replay_buffer: ReplayBuffer

    def __init__(
        self,
        environment: VecEnv,
        seed: int,
        return_steps: int = 1,
        standardised: bool = False,
        starts_at_mean_reward: bool = False,
        **arguments: Any,
    ) -> None:
        self.rng = np.random.default_rng([seed, 2])
        self.return_steps = return_steps
        self.standardised = standardised
        self.starts_at_mean_reward = starts_at_mean_reward
        self.loss = float("nan")
        super().__init__("MlpPolicy", environment, seed=seed, **arguments)

    def train(self, gradient_steps: int, batch_size: int = 32) -> None:
        """Takes gradient steps on the squared error to y_t, eq. 3 of the paper."""
        if self.starts_at_mean_reward and not self._n_updates:
            self._raise_values()
        buffer, shape = self.replay_buffer, (gradient_steps, batch_size)
        rows = self.rng.integers(buffer.size(), size=shape)
        envs = self.rng.integers(buffer.n_envs, size=shape)
        returns, discounts, last = self.returns(rows, envs)
        observations = self._seen(buffer.observations[rows, envs])
        next_observations = self._seen(buffer.next_observations[last, envs])
        actions = torch.from_numpy(buffer.actions[rows, envs])
        rewards, factors = torch.from_numpy(returns), torch.from_numpy(discounts)
        # The inner networks: the outer ones only flatten observations first.
        online, target = self.q_net.q_net, self.q_net_target.q_net
        optimizer, parameters = self.policy.optimizer, list(online.parameters())
        for group in optimizer.param_groups:
            group["lr"] = self.lr_schedule(self._current_progress_remaining)
        with torch.no_grad():  # the target network does not change in between
            next_values = target(next_observations)
        losses = np.empty(gradient_steps)
        for k in range(gradient_steps):
            with torch.no_grad():
                best = online(next_observations[k]).argmax(dim=1, keepdim=True)
                following = next_values[k].gather(1, best)[:, 0]
                wanted = rewards[k] + factors[k] * following
            losses[k] = squared_error(online, observations[k], actions[k], wanted)
            torch.nn.utils.clip_grad_norm_(parameters, self.max_grad_norm)
            optimizer.step()
        self._n_updates += gradient_steps
        self.loss = float(losses.mean())

    def _raise_values(self) -> None:
        """Adds the discounted sum of mean rewards to the values of both networks."""
        buffer, size = self.replay_buffer, self.replay_buffer.size()
        has_failed = (buffer.dones[:size] == 1) & (buffer.timeouts[:size] == 0)
        rewards = buffer.rewards[:size][~has_failed]
        with torch.no_grad():
            for network in (self.q_net.q_net, self.q_net_target.q_net):
                last = network[-1]
                assert isinstance(last, Linear)
                last.bias.add_(float(rewards.mean()) / (1 - self.gamma))

    def returns(self, rows: NDArray[Any], envs: NDArray[Any]) -> Returns:
        """The parts of y_t, eq. 3 of the paper, from steps in the replay buffer, of any one shape.

        A return adds up the rewards of `return_steps` steps, or of fewer if the episode or the
        buffer ends before.

        Returns:
            The sums of discounted rewards; the discounts of the values after the last steps, 0
            after a failure; and the rows of the last steps in the buffer.
        """
        buffer = self.replay_buffer
        newest = (buffer.pos - 1) % buffer.buffer_size
        last, rewards = rows, buffer.rewards[rows, envs]
        discounts = np.full(rows.shape, self.gamma, dtype=np.float32)
        for _ in range(1, self.return_steps):
            goes_on = (buffer.dones[last, envs] == 0) & (last != newest)
            last = np.where(goes_on, (last + 1) % buffer.buffer_size, last)
            rewards += np.where(goes_on, discounts * buffer.rewards[last, envs], 0)
            discounts *= np.where(goes_on, np.float32(self.gamma), 1)
        # An episode that ended by time could have continued, so its last observation has a value.
        discounts *= 1 - buffer.dones[last, envs] * (1 - buffer.timeouts[last, envs])
        return rewards, discounts, last

    def values(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """The online network's values (M, 5) of observations (M, 7, 5)."""
        with torch.no_grad():
            values: NDArray[np.float32] = self.q_net.q_net(self._seen(observations)).numpy()
        return values

    @property
    def network(self) -> Sequential:
        """The online network, made to take plain observations."""
        network: Sequential = self.q_net.q_net
        return folded(network) if self.standardised else network

    def _seen(self, observations: NDArray[np.float32]) -> torch.Tensor:
        """Observations (..., 7, 5) in the form that the networks take, (..., 35)."""
        flat = torch.from_numpy(observations).flatten(-2)
        return standardise(flat) if self.standardised else flat

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        count = self.action_space.n  # type: ignore[attr-defined]  # all are Discrete
        actions = self.rng.integers(count, size=n_envs)
        if self.num_timesteps >= learning_starts:
            assert isinstance(self._last_obs, np.ndarray)
            greedy = self.values(self._last_obs).argmax(axis=1)
            explores = self.rng.random(n_envs) < self.exploration_rate
            actions = np.where(explores, actions, greedy)
        return actions, actions

    @property
    def _networks(self) -> dict[str, Module]:
        return {"q_net": self.q_net, "q_net_target": self.q_net_target}

    def arrays(self) -> Arrays:
        """Everything that further training depends on except the environment, as plain arrays."""
        buffer = self.replay_buffer
        arrays = state_arrays(self._networks, self.policy.optimizer)
        for name in _REPLAYED:
            arrays[f"replay/{name}"] = getattr(buffer, name)[: buffer.size()]
        numbers = {
            "counters": {name: getattr(self, name) for name in _COUNTERS},
            "rng": self.rng.bit_generator.state,
            "loss": self.loss,
            "replay": {"pos": buffer.pos, "full": buffer.full},
        }
        arrays["numbers"] = np.array(json.dumps(numbers))
        return arrays

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same configuration."""
        buffer = self.replay_buffer
        numbers = json.loads(str(arrays["numbers"]))
        load_state(self._networks, self.policy.optimizer, arrays)
        for name in _REPLAYED:
            stored = arrays[f"replay/{name}"]
            getattr(buffer, name)[: len(stored)] = stored
        buffer.pos, buffer.full = numbers["replay"]["pos"], numbers["replay"]["full"]
        for name in _COUNTERS:
            setattr(self, name, numbers["counters"][name])
        self.rng.bit_generator.state = numbers["rng"]
        self.loss = numbers["loss"]
