"""What Stable-Baselines3 keeps in `policy.pth`, of networks that are all zeros.

A keyword takes the place of a tensor, `__` being its dots; None leaves the tensor out.
"""

from typing import Any

import torch


def dqn_weights(**changes: Any) -> dict[str, Any]:
    """Those of a DQN with one hidden layer."""
    tensors = {
        "q_net.q_net.0.weight": torch.zeros(4, 35),
        "q_net.q_net.0.bias": torch.zeros(4),
        "q_net.q_net.2.weight": torch.zeros(5, 4),
        "q_net.q_net.2.bias": torch.zeros(5),
    }
    return _with(changes, tensors)


def ppo_weights(**changes: Any) -> dict[str, Any]:
    """Those of a PPO whose policy has no hidden layer."""
    tensors = {
        "action_net.weight": torch.zeros(5, 35),
        "action_net.bias": torch.zeros(5),
        "value_net.weight": torch.zeros(1, 35),
        "value_net.bias": torch.zeros(1),
    }
    return _with(changes, tensors)


def recurrent_weights(lstm: torch.nn.LSTM, **changes: Any) -> dict[str, Any]:
    """Those of a RecurrentPPO with this LSTM and a policy without hidden layers."""
    tensors = {f"lstm_actor.{name}": tensor for name, tensor in lstm.state_dict().items()}
    tensors |= {f"lstm_critic.{name}": tensor for name, tensor in lstm.state_dict().items()}
    width = lstm.hidden_size
    tensors |= {"action_net.weight": torch.eye(5, width), "action_net.bias": torch.zeros(5)}
    tensors |= {"value_net.weight": torch.zeros(1, width), "value_net.bias": torch.zeros(1)}
    return _with(changes, tensors)


def _with(changes: dict[str, Any], tensors: dict[str, Any]) -> dict[str, Any]:
    tensors |= {name.replace("__", "."): tensor for name, tensor in changes.items()}
    return {name: tensor for name, tensor in tensors.items() if tensor is not None}
