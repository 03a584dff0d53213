"""Double DQN (van Hasselt et al. 2016) on Stable-Baselines3's DQN."""

import json
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.vec_env import VecEnv
from torch.nn import Sequential
from torch.nn.functional import mse_loss

from charms_agents.training.job import Arrays
from charms_agents.training.standardised import folded, standardise

_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_COUNTERS = ("num_timesteps", "exploration_rate", "_n_calls", "_n_updates", "_episode_num")


class Returns(NamedTuple):
    """What y_t is made of, eq. 3 of the paper, over one step or several."""

    rewards: NDArray[np.float32]
    """The sum of the steps' discounted rewards."""
    discounts: NDArray[np.float32]
    """That of the value after the last step; 0 after a failure."""
    last: NDArray[Any]
    """The row of the last step."""


class DoubleDQN(DQN):
    """DQN in which the online network chooses the action that the target network values.

    Beside that it differs from its base in three ways. The loss is the squared error, as in the
    paper. Every environment explores by a draw of its own, where the base lets all explore in
    the same steps. All chance after the initial weights comes from one generator, so that
    `arrays` and `load_arrays` can take everything along.

    Args:
        environment: Its observations are flattened.
        seed: Of the initial weights and of exploration and replay.
        return_steps: Rewards that y_t adds up before it looks at a value (n-step returns).
        standardised: Whether the networks take standardised observations.
        arguments: As for `DQN`.
    """

    def __init__(
        self,
        environment: VecEnv,
        seed: int,
        return_steps: int = 1,
        standardised: bool = False,
        **arguments: Any,
    ) -> None:
        self.rng = np.random.default_rng([seed, 2])
        self.return_steps = return_steps
        self.standardised = standardised
        self.loss = float("nan")
        super().__init__("MlpPolicy", environment, seed=seed, **arguments)

    def train(self, gradient_steps: int, batch_size: int = 32) -> None:
        """Takes gradient steps on the squared error to y_t, eq. 3 of the paper."""
        buffer, shape = self.replay_buffer, (gradient_steps, batch_size)
        assert buffer is not None
        rows = self.rng.integers(buffer.size(), size=shape)
        envs = self.rng.integers(buffer.n_envs, size=shape)
        returns = self.returns(rows, envs)
        observations = self._seen(buffer.observations[rows, envs])
        next_observations = self._seen(buffer.next_observations[returns.last, envs])
        actions = torch.from_numpy(buffer.actions[rows, envs])
        rewards = torch.from_numpy(returns.rewards)
        discounts = torch.from_numpy(returns.discounts)
        # The networks behind Stable-Baselines3's preprocessing, which only flattens.
        online, target = self.q_net.q_net, self.q_net_target.q_net
        optimizer, parameters = self.policy.optimizer, list(online.parameters())
        for group in optimizer.param_groups:
            group["lr"] = self.lr_schedule(self._current_progress_remaining)
        with torch.no_grad():  # the target network stays the same throughout
            next_values = target(next_observations)
        losses = torch.empty(gradient_steps)
        for k in range(gradient_steps):
            with torch.no_grad():
                best = online(next_observations[k]).argmax(dim=1, keepdim=True)
                following = next_values[k].gather(1, best)[:, 0]
                wanted = rewards[k] + discounts[k] * following
            values = online(observations[k]).gather(1, actions[k])[:, 0]
            loss = mse_loss(values, wanted)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]  # of torch
            torch.nn.utils.clip_grad_norm_(parameters, self.max_grad_norm)
            optimizer.step()
            losses[k] = loss.detach()
        self._n_updates += gradient_steps
        self.loss = float(losses.mean())

    def returns(self, rows: NDArray[Any], envs: NDArray[Any]) -> "Returns":
        """What came of steps of the replay buffer, any shape.

        Adds up the rewards of `return_steps` steps, or of those until the episode ends or until the
        buffer's newest step.
        """
        buffer = self.replay_buffer
        assert buffer is not None
        newest = (buffer.pos - 1) % buffer.buffer_size
        last, rewards = rows, buffer.rewards[rows, envs]
        discounts = np.full(rows.shape, self.gamma, dtype=np.float32)
        for _ in range(1, self.return_steps):
            goes_on = (buffer.dones[last, envs] == 0) & (last != newest)
            last = np.where(goes_on, (last + 1) % buffer.buffer_size, last)
            rewards += np.where(goes_on, discounts * buffer.rewards[last, envs], 0)
            discounts *= np.where(goes_on, np.float32(self.gamma), 1)
        # An episode whose time is over would have gone on: its last observation has a value.
        discounts *= 1 - buffer.dones[last, envs] * (1 - buffer.timeouts[last, envs])
        return Returns(rewards, discounts, last)

    def values(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """The online network's values (M, 5) of observations (M, 7, 5)."""
        with torch.no_grad():
            values: NDArray[np.float32] = self.q_net.q_net(self._seen(observations)).numpy()
        return values

    @property
    def network(self) -> Sequential:
        """The online network as one that takes plain observations."""
        network: Sequential = self.q_net.q_net
        return folded(network) if self.standardised else network

    def _seen(self, observations: NDArray[np.float32]) -> torch.Tensor:
        """Observations (..., 7, 5) as the networks take them, (..., 35)."""
        flat = torch.from_numpy(observations).flatten(-2)
        return standardise(flat) if self.standardised else flat

    def recorded_observations(self) -> NDArray[np.float32]:
        """What was seen in the last steps: all that the replay buffer holds, (M, 7, 5)."""
        buffer = self.replay_buffer
        assert buffer is not None
        observations: NDArray[np.float32] = buffer.observations[: buffer.size()]
        return observations.reshape(-1, 7, 5)

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

    def arrays(self) -> Arrays:
        """Everything that further training depends on, but for the environment, as plain arrays."""
        buffer = self.replay_buffer
        assert buffer is not None
        arrays: Arrays = {}
        for network in ("q_net", "q_net_target"):
            for name, tensor in getattr(self, network).state_dict().items():
                arrays[f"{network}/{name}"] = tensor.numpy()
        for index, moments in self.policy.optimizer.state_dict()["state"].items():
            for name, tensor in moments.items():
                arrays[f"optimizer/{index}/{name}"] = tensor.numpy()
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
        """Takes over what `arrays` of an equally configured one returned."""
        buffer, optimizer = self.replay_buffer, self.policy.optimizer
        assert buffer is not None
        numbers = json.loads(str(arrays["numbers"]))
        for network in ("q_net", "q_net_target"):
            module = getattr(self, network)
            module.load_state_dict(
                {
                    name: torch.from_numpy(arrays[f"{network}/{name}"])
                    for name in module.state_dict()
                }
            )
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key in (key for key in arrays if key.startswith("optimizer/")):
            _, index, name = key.split("/")
            state.setdefault(int(index), {})[name] = torch.from_numpy(arrays[key])
        groups = optimizer.state_dict()["param_groups"]
        optimizer.load_state_dict({"state": state, "param_groups": groups})
        for name in _REPLAYED:
            stored = arrays[f"replay/{name}"]
            getattr(buffer, name)[: len(stored)] = stored
        buffer.pos, buffer.full = numbers["replay"]["pos"], numbers["replay"]["full"]
        for name in _COUNTERS:
            setattr(self, name, numbers["counters"][name])
        self.rng.bit_generator.state = numbers["rng"]
        self.loss = numbers["loss"]
