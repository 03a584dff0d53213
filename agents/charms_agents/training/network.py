"""Policy networks: linear layers with ReLU or tanh between them, in torch, ONNX and arrays."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from numpy.typing import NDArray
from onnx import numpy_helper
from torch.nn import Linear, Module, ReLU, Sequential, Tanh

from charms_bench.errors import ModelError
from charms_bench.world.actions import ACTIONS
from charms_bench.world.scene import Observations

OBSERVED = 35
"""Size of the observation `neighbours`, 7 rows of 5 numbers."""

ACTIVATIONS: dict[str, type[Module]] = {"Relu": ReLU, "Tanh": Tanh}
"""The activations that are allowed between layers, by their ONNX name."""

Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]
"""The weight (outputs, inputs) and the bias (outputs,) of each linear layer, first to last."""


def untrained(hidden_layers: Sequence[int], seed: int) -> Sequential:
    """A network with torch's initial weights for a seed."""
    sizes = (OBSERVED, *hidden_layers, len(ACTIONS))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return _alternating([Linear(before, after) for before, after in pairwise(sizes)], ReLU)


def network_of(layers: Layers, activation: type[Module] = ReLU) -> Sequential:
    """A network of copies of the layers, with an activation between them."""
    modules = []
    for weight, bias in layers:
        module = Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            module.weight.copy_(torch.from_numpy(weight.copy()))
            module.bias.copy_(torch.from_numpy(bias.copy()))
        modules.append(module)
    return _alternating(modules, activation)


def layers_of(network: Sequential) -> Layers:
    """The linear layers of a network."""
    return [
        (module.weight.detach().numpy(), module.bias.detach().numpy())
        for module in network
        if isinstance(module, Linear)
    ]


def read_network(path: Path) -> Sequential:
    """Reads the network of an ONNX file that `export` wrote.

    Raises:
        ModelError: The file cannot be read, or holds a different kind of network.
    """
    try:
        graph = onnx.load(path, load_external_data=False).graph
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    except DecodeError as error:
        raise ModelError(f"{path}: not an ONNX file: {error}") from error
    arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    names = [(f"weight_{index}", f"bias_{index}") for index in range(len(arrays) // 2)]
    if set(arrays) != {name for pair in names for name in pair} or not names:
        raise ModelError(f"{path}: was not written by this pipeline; it holds {list(arrays)}")
    found = [ACTIVATIONS[node.op_type] for node in graph.node if node.op_type in ACTIVATIONS]
    layers = [(arrays[weight], arrays[bias]) for weight, bias in names]
    return network_of(layers, found[0] if found else ReLU)


def values_of(network: Sequential, observations: Observations) -> NDArray[np.float32]:
    """The network's values (M, 5) of observations (M, rows, columns)."""
    flat = torch.tensor(observations.reshape(len(observations), -1))  # a copy, as writable
    with torch.no_grad():
        values: NDArray[np.float32] = network(flat).numpy()
    return values


def _alternating(layers: Sequence[Linear], activation: type[Module]) -> Sequential:
    modules: list[Module] = []
    for layer in layers:
        modules += [layer, activation()]
    return Sequential(*modules[:-1])


def module_arrays(name: str, module: Module) -> dict[str, NDArray[Any]]:
    """The parameters of a module as `name/parameter`."""
    return {f"{name}/{key}": tensor.numpy() for key, tensor in module.state_dict().items()}


def load_module(name: str, module: Module, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Takes over what `module_arrays` returned for a module of the same shape."""
    keys = module.state_dict()
    module.load_state_dict({key: torch.from_numpy(arrays[f"{name}/{key}"]) for key in keys})


def optimizer_arrays(optimizer: torch.optim.Optimizer) -> dict[str, NDArray[Any]]:
    """The state of an optimizer as `optimizer/parameter/moment`."""
    return {
        f"optimizer/{index}/{name}": tensor.numpy()
        for index, moments in optimizer.state_dict()["state"].items()
        for name, tensor in moments.items()
    }


def load_optimizer(optimizer: torch.optim.Optimizer, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Takes over what `optimizer_arrays` returned for an optimizer of the same parameters."""
    state: dict[int, dict[str, torch.Tensor]] = {}
    for key in (key for key in arrays if key.startswith("optimizer/")):
        _, index, name = key.split("/")
        state.setdefault(int(index), {})[name] = torch.from_numpy(arrays[key])
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": state, "param_groups": groups})
