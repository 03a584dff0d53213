"""Policy networks: linear layers with an activation between them, in torch and in arrays."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import Linear, Module, ReLU, Sequential, Tanh
from torch.optim import Optimizer

from charms_bench.world.actions import ACTIONS

ACTIVATIONS: dict[str, type[Module]] = {"Relu": ReLU, "Tanh": Tanh}
"""The activations that are trained here, by their ONNX name."""

Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]
"""The weight (outputs, inputs) and the bias (outputs,) of each linear layer, first to last."""
Arrays = dict[str, NDArray[Any]]
"""The content of a checkpoint: plain arrays, which are read without running any code."""


def untrained(
    hidden_layers: Sequence[int], seed: int, inputs: int = 35, outputs: int = len(ACTIONS)
) -> Sequential:
    """A network with torch's initial weights for a seed."""
    sizes = (inputs, *hidden_layers, outputs)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return _alternating([Linear(before, after) for before, after in pairwise(sizes)], ReLU)


def network_of(
    layers: Layers, activation: type[Module] = ReLU, squashed: bool = False
) -> Sequential:
    """A network of copies of the layers, with an activation between them.

    If it is squashed, a tanh follows the last layer.
    """
    modules = []
    for weight, bias in layers:
        module = Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            module.weight.copy_(torch.from_numpy(weight.copy()))
            module.bias.copy_(torch.from_numpy(bias.copy()))
        modules.append(module)
    network = _alternating(modules, activation)
    return network.append(Tanh()) if squashed else network


def side_by_side(network: Sequential, factor: float, other: Sequential) -> Sequential:
    """One network with ReLUs, whose values are `factor` times those of one plus those of another.

    Both take the same inputs and have equally many layers.
    """
    joined: Layers = []
    pairs = list(zip(layers_of(network), layers_of(other), strict=True))
    for index, ((weight, bias), (other_weight, other_bias)) in enumerate(pairs):
        if index == len(pairs) - 1:
            own = weight * np.float32(factor)
            whole = np.hstack([own, other_weight]) if index else own + other_weight
            joined.append((whole, bias * np.float32(factor) + other_bias))
            continue
        if index == 0:
            whole = np.vstack([weight, other_weight])
        else:
            (rows, columns), (other_rows, other_columns) = weight.shape, other_weight.shape
            whole = np.zeros((rows + other_rows, columns + other_columns), dtype=np.float32)
            whole[:rows, :columns], whole[rows:, columns:] = weight, other_weight
        joined.append((whole, np.concatenate([bias, other_bias])))
    return network_of(joined)


def widened(network: Sequential, inputs: int) -> Sequential:
    """The network with `inputs` further inputs, which have no effect."""
    (weight, bias), *others = layers_of(network)
    return network_of([(np.pad(weight, ((0, 0), (0, inputs))), bias), *others])


def layers_of(network: Sequential) -> Layers:
    """The linear layers of a network."""
    return [
        (module.weight.detach().numpy(), module.bias.detach().numpy())
        for module in network
        if isinstance(module, Linear)
    ]


def _alternating(layers: Sequence[Linear], activation: type[Module]) -> Sequential:
    modules: list[Module] = []
    for layer in layers:
        modules += [layer, activation()]
    return Sequential(*modules[:-1])


def state_arrays(networks: Mapping[str, Module], optimizer: Optimizer) -> Arrays:
    """The state of networks as `name/parameter` and of an optimizer as `optimizer/row/moment`."""
    states = {name: network.state_dict() for name, network in networks.items()}
    for index, moments in optimizer.state_dict()["state"].items():
        states[f"optimizer/{index}"] = moments
    return {
        f"{name}/{key}": tensor.numpy()
        for name, tensors in states.items()
        for key, tensor in tensors.items()
    }


def load_state(networks: Mapping[str, Module], optimizer: Optimizer, arrays: Arrays) -> None:
    """Takes over what `state_arrays` returned for networks of the same shapes."""
    for name, network in networks.items():
        keys = network.state_dict()
        network.load_state_dict({key: torch.from_numpy(arrays[f"{name}/{key}"]) for key in keys})
    state: dict[int, dict[str, Tensor]] = {}
    for key in arrays:
        if key.startswith("optimizer/"):
            _, index, name = key.split("/")
            state.setdefault(int(index), {})[name] = torch.from_numpy(arrays[key])
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
