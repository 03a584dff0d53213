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
from onnx import TensorProto, helper, numpy_helper
from torch.nn import Linear, Module, ReLU, Sequential, Tanh
from torch.optim import Optimizer

from charms_bench.errors import ModelError
from charms_bench.foundation.files import write_atomically
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.onnx_ports import MASK_INPUT
from charms_bench.world.actions import ACTIONS, ActionKind, outputs_of
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import ACTION_MASK, Neighbours, described, neighbours
from charms_bench.world.scene import Observations

OBSERVED = 35
"""Size of the observation `neighbours`, 7 rows of 5 numbers."""

ACTIVATIONS: dict[str, type[Module]] = {"Relu": ReLU, "Tanh": Tanh}
"""The activations that are allowed between layers, by their ONNX name."""

OPSET, IR_VERSION = 17, 8
"""Old versions, which every onnxruntime that the base install allows can read."""
TIE = 1e-4
"""Two actions whose values differ by less are equally good to float32's precision; continuous
actions that differ by less are equal."""

MASKED = 1e8
"""What a masked action loses of its value, as in sb3-contrib."""

Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]
"""The weight (outputs, inputs) and the bias (outputs,) of each linear layer, first to last."""
Arrays = dict[str, NDArray[Any]]
"""The content of a checkpoint: plain arrays, which are read without running any code."""


def untrained(hidden_layers: Sequence[int], seed: int) -> Sequential:
    """A network with torch's initial weights for a seed."""
    sizes = (OBSERVED, *hidden_layers, len(ACTIONS))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return _alternating([Linear(before, after) for before, after in pairwise(sizes)], ReLU)


def network_of(
    layers: Layers, activation: type[Module] = ReLU, kind: ActionKind = "meta"
) -> Sequential:
    """A network of copies of the layers, with an activation between them.

    For continuous actions, a tanh follows the last layer.
    """
    modules = []
    for weight, bias in layers:
        module = Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            module.weight.copy_(torch.from_numpy(weight.copy()))
            module.bias.copy_(torch.from_numpy(bias.copy()))
        modules.append(module)
    network = _alternating(modules, activation)
    return network if kind == "meta" else network.append(Tanh())


def kind_of(network: Sequential) -> ActionKind:
    """The kind of a network's actions: continuous if it ends with a tanh."""
    return "continuous" if isinstance(network[-1], Tanh) else "meta"


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


def _alternating(layers: Sequence[Linear], activation: type[Module]) -> Sequential:
    modules: list[Module] = []
    for layer in layers:
        modules += [layer, activation()]
    return Sequential(*modules[:-1])


def export(
    network: Sequential,
    path: Path,
    facts: dict[str, str],
    observations: Observations,
    observation: Neighbours | Kinematics = neighbours,
    masked: bool = False,
) -> dict[str, int]:
    """Writes a network as an ONNX file that `OnnxPolicy` runs.

    Args:
        network: Linear layers with ReLU or tanh between them; for continuous actions, a tanh
            follows the last layer.
        path: The file.
        facts: Further metadata, beside the observation and the actions.
        observations: (M, rows, columns) on which the file's actions are compared with the
            network's. If the file is masked, their last row is the action mask.
        observation: The observation of the network.
        masked: Whether the file has a second input, the action mask, and never chooses a masked
            action.

    Returns:
        observations, the number compared; ties, the number in which the file chose a different
        action of equal value to float32's precision, or the actions differ by at most `TIE`.

    Raises:
        ModelError: The file acts differently from the network; nothing is written.
        RunFolderError: The file cannot be written.
    """
    shape = observation.shape
    data = _serialised(network, {"observation": described(observation), **facts}, shape, masked)
    flat = torch.tensor(observations[:, : shape[0]].reshape(len(observations), -1))  # writable
    with torch.no_grad():
        expected: NDArray[np.float32] = network(flat).numpy()
    if masked:
        expected += (observations[:, ACTION_MASK] - 1) * MASKED
    continuous = kind_of(network) == "continuous"
    checked: dict[str, int] = {}

    def write(partial: Path) -> None:
        partial.write_bytes(data)
        found = OnnxPolicy(partial).decide(observations)
        if continuous:
            lost = np.abs(found - expected).max(axis=1)
            ties = lost > 0
        else:
            lost = expected.max(axis=1) - expected[np.arange(found.size), found]
            ties = found != expected.argmax(axis=1)
        if count := int((lost > TIE).sum()):
            raise ModelError(
                f"{path}: would act differently from the network in {count} of {len(found)} "
                "observations; onnxruntime and torch disagree on this machine"
            )
        checked.update(observations=len(found), ties=int(ties.sum()))

    write_atomically(path, write)
    return checked


def _serialised(
    network: Sequential, facts: dict[str, str], shape: tuple[int, int], masked: bool
) -> bytes:
    layers = layers_of(network)
    operators = {kind: name for name, kind in ACTIVATIONS.items()}
    after = [operators[type(module)] for module in network if type(module) in operators]
    tensors: list[TensorProto] = []
    last, end = "flat", "unmasked" if masked else "values"
    nodes = [helper.make_node("Flatten", ["observations"], [last], axis=1)]
    for index, (weight, bias) in enumerate(layers):
        parameters = [f"weight_{index}", f"bias_{index}"]
        tensors += map(numpy_helper.from_array, (weight, bias), parameters)
        final, activated = index == len(layers) - 1, index < len(after)
        out = end if final and not activated else f"linear_{index}"
        nodes.append(helper.make_node("Gemm", [last, *parameters], [out], transB=1))
        if activated:
            last = end if final else f"hidden_{index}"
            nodes.append(helper.make_node(after[index], [out], [last]))
    seen = helper.make_tensor_value_info("observations", TensorProto.FLOAT, ["batch", *shape])
    kind = kind_of(network)
    actions = ", ".join(ACTIONS) if kind == "meta" else kind
    size = outputs_of(kind)
    valued = helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", size])
    inputs = [seen]
    if masked:
        wide: list[str | int | None] = ["batch", len(ACTIONS)]
        inputs.append(helper.make_tensor_value_info(MASK_INPUT, TensorProto.FLOAT, wide))
        constants = {"one": 1.0, "masked": MASKED}
        tensors += [
            numpy_helper.from_array(np.array(v, dtype=np.float32), k) for k, v in constants.items()
        ]
        nodes.append(helper.make_node("Sub", [MASK_INPUT, "one"], ["closed"]))
        nodes.append(helper.make_node("Mul", ["closed", "masked"], ["lost"]))
        nodes.append(helper.make_node("Add", [end, "lost"], ["values"]))
    graph = helper.make_graph(nodes, "policy", inputs, [valued], tensors)
    exported = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
    )
    helper.set_model_props(exported, {"actions": actions, **facts})
    onnx.checker.check_model(exported, full_check=True)
    data: bytes = exported.SerializeToString(deterministic=True)
    return data


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
    state: dict[int, dict[str, torch.Tensor]] = {}
    for key in arrays:
        if key.startswith("optimizer/"):
            _, index, name = key.split("/")
            state.setdefault(int(index), {})[name] = torch.from_numpy(arrays[key])
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
