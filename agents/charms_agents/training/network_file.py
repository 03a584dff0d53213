"""Policy networks as ONNX files: an LSTM, linear layers, the action mask and the random choice.

`onnx_input` has what comes before them.
"""

import json
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from numpy.typing import NDArray
from onnx import helper, numpy_helper
from torch.nn import LSTM, Module, ReLU, Sequential

from charms_agents.training.network import ACTIVATIONS, layers_of, network_of
from charms_agents.training.onnx_input import Given, Graph, port
from charms_bench.errors import ModelError
from charms_bench.foundation.files import write_atomically, write_bytes
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.onnx_ports import MASK_INPUT, NOISE_INPUT, STYLE_INPUT
from charms_bench.world.action_mask import masks_of
from charms_bench.world.action_texts import metadata_of
from charms_bench.world.actions import ActionsLike, meta_actions_of
from charms_bench.world.observations import ACTION_MASK, NamedObservation, described, neighbours
from charms_bench.world.scene import Observations

OPSET, IR_VERSION = 17, 8
"""Old versions, which every onnxruntime that the base install allows can read."""
TIE, TIE_OF = 1e-4, 100.0
"""Two actions whose values differ by less are equally good to float32's precision, if no value is
larger than `TIE_OF`; of larger values, proportionally more. Continuous actions that differ by less
are equal."""
SURE, ROUNDED = 8.0, 20_000
"""So are actions whose values differ by less than this times the network's own error in float32,
which is the largest one in so many observations: large terms of a sum may cancel each other."""
MASKED = 1e8
"""What a masked action loses of its value, as in sb3-contrib."""
SMALLEST_DRAW, LARGEST_DRAW = 1e-20, 1 - 2**-24
DRAW_RANGE = {"smallest": SMALLEST_DRAW, "largest": LARGEST_DRAW}
"""The range of random numbers whose double logarithm is finite, and its names in a file."""
STEPS = 4
"""Decisions in a row for which a network with memory is compared."""
_READ = {"Flatten", "Gemm", "Sub", "Mul", "Add", "Clip", "Log", "Neg", *ACTIVATIONS}
"""The operators of the files that `read_network` reads."""
Steps = tuple[tuple[str, tuple[str | float, ...]], ...]
"""Operators and their inputs: a number, `x`, or the operator whose result it is."""
_STEPS: dict[type[Module], Steps] = {
    **{kind: ((name, ("x",)),) for name, kind in ACTIVATIONS.items()},
    torch.nn.ELU: (("Elu", ("x",)),),
    torch.nn.CELU: (("Celu", ("x",)),),
    torch.nn.SELU: (("Selu", ("x",)),),
    torch.nn.LeakyReLU: (("LeakyRelu", ("x",)),),
    torch.nn.Hardswish: (("HardSwish", ("x",)),),
    torch.nn.Sigmoid: (("Sigmoid", ("x",)),),
    torch.nn.Softplus: (("Softplus", ("x",)),),
    torch.nn.Softsign: (("Softsign", ("x",)),),
    torch.nn.SiLU: (("Sigmoid", ("x",)), ("Mul", ("x", "Sigmoid"))),
    torch.nn.Mish: (("Softplus", ("x",)), ("Tanh", ("Softplus",)), ("Mul", ("x", "Tanh"))),
    torch.nn.GELU: (
        ("Mul", ("x", 0.5**0.5)),
        ("Erf", ("Mul",)),
        ("Add", ("Erf", 1.0)),
        ("Mul", ("Add", 0.5)),
        ("Mul", ("x", "Mul")),
    ),
}
"""How ONNX computes the activations, with torch's default options."""
KINDS = {kind.__name__: kind for kind in _STEPS}
"""The activations that a file can have, by their torch name."""


def read_network(path: Path) -> Sequential:
    """The network of a file that `export` wrote, without what draws its actions from its values.

    Raises a `ModelError` for any other file.
    """
    try:
        graph = onnx.load(path, load_external_data=False).graph
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    except DecodeError as error:
        raise ModelError(f"{path}: not an ONNX file: {error}") from error
    tensors = (tensor for tensor in graph.initializer if tensor.name not in DRAW_RANGE)
    arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in tensors}
    names = [(f"weight_{index}", f"bias_{index}") for index in range(len(arrays) // 2)]
    others = {node.op_type for node in graph.node} - _READ
    if set(arrays) != {name for pair in names for name in pair} or not names or others:
        raise ModelError(f"{path}: was not written by this pipeline; it holds {[*arrays, *others]}")
    found = [ACTIVATIONS[node.op_type] for node in graph.node if node.op_type in ACTIVATIONS]
    layers = [(arrays[weight], arrays[bias]) for weight, bias in names]
    return network_of(layers, found[0] if found else ReLU)


def export(
    network: Sequential,
    path: Path,
    facts: dict[str, str],
    observations: Observations,
    observation: NamedObservation = neighbours,
    masked: bool = False,
    lstm: LSTM | None = None,
    stochastic: bool = False,
    given: Given | None = None,
    actions: ActionsLike = "meta",
    styles: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> dict[str, int]:
    """Writes a network as an ONNX file that `OnnxPolicy` runs.

    Args:
        network: Linear layers with an activation of `KINDS` between them; a tanh may follow the
            last layer of one with continuous actions, which are otherwise clipped.
        facts: Further metadata, beside the observation and the actions.
        observations: (M, rows, columns), or (M, history, rows, columns), on which the file's
            actions are compared with the network's. If the file is masked, their last row is the
            action mask.
        masked: Whether a second input is the action mask, and no masked action is ever chosen.
        lstm: The network's inputs are the outputs of this LSTM, and the file has its states. The
            observations are compared as those of `STEPS` decisions in a row.
        stochastic: Whether the file has an input of random numbers, by which it draws its actions;
            the network's values are the logits.
        given: What the network is given of the observations; by default, the observations.
        actions: What the network's outputs are the values of, or continuous actions.
        styles: The last inputs of the network in each style in which it drives, if there are
            several. Observation m is compared in the style m modulo their number.

    Returns:
        observations, the number compared; ties, the number in which the file chose a different
        action of equal value to float32's precision, or the actions differ by at most `TIE`.

    Raises:
        ModelError: The file acts differently from the network; nothing is written.
        RunFolderError: The file cannot be written.
    """
    given, steps = given or Given(), STEPS if lstm else 1
    seen, history = observations, given.history
    facts = {"observation": described(observation), **facts}
    if history > 1:
        facts["history"] = str(history)
    if styles:
        facts["styles"] = json.dumps(dict(styles))
    shape = (*(history,) * (history > 1), *observation.shape)
    width = len(next(iter(styles.values()), ()))
    data = _serialised(network, facts, shape, masked, lstm, stochastic, given, actions, width)
    if masked:
        seen = observations[..., : observation.shape[0], :]
    flat = torch.tensor(given.of(seen.reshape(len(seen), history, -1)))  # writable
    if styles:
        of_each = torch.tensor([*styles.values()])[torch.arange(len(flat)) % len(styles)]
        flat = torch.cat([flat, of_each], dim=1)
    newest = observations if history == 1 else observations[:, -1]
    draws = layers_of(network)[-1][1].size * stochastic
    noise = np.random.default_rng(0).random((len(flat), draws), np.float32)
    with torch.no_grad():
        hidden = lstm(flat.reshape(steps, -1, flat.shape[1]))[0].flatten(0, 1) if lstm else flat
        expected: NDArray[np.float32] = network(hidden).numpy()
        rounding = _rounding(network, hidden, expected)
    if masked:
        masks = masks_of(newest[:, ACTION_MASK], meta_actions_of(actions))
        expected += (masks - 1) * MASKED
    if stochastic:
        expected -= np.log(-np.log(noise))
    continuous = actions == "continuous"
    if continuous:
        expected = np.clip(expected, -1.0, 1.0)
    checked: dict[str, int] = {}

    def write(partial: Path) -> None:
        partial.write_bytes(data)
        policies = [OnnxPolicy(partial, style=name) for name in styles or (None,)]
        memory, actions, policy = None, [], policies[0]
        for part, draws in zip(np.split(observations, steps), np.split(noise, steps), strict=True):
            values, memory = policy.values_and_memory(part, memory, draws.astype(np.float64))
            actions.append(policy.actions_of(values))
        found = np.concatenate(actions)
        for k, other in enumerate(policies[1:], 1):
            rows = slice(k, None, len(policies))
            found[rows] = other.decide(observations[rows], None, noise[rows].astype(np.float64))
        if continuous:
            lost = np.abs(found[:, policy.controls] - expected).max(axis=1)
            ties = lost > 0
        else:
            lost = expected.max(axis=1) - expected[np.arange(found.size), found]
            ties = found != expected.argmax(axis=1)
        largest = np.abs(expected).max(axis=1, initial=TIE_OF)
        if count := int((lost > np.maximum(TIE * largest / TIE_OF, SURE * rounding)).sum()):
            raise ModelError(
                f"{path}: would act differently from the network in {count} of {len(found)} "
                "observations; onnxruntime and torch disagree on this machine"
            )
        checked.update(observations=len(found), ties=int(ties.sum()))

    write_atomically(path, write)
    return checked


def _rounding(network: Sequential, given: torch.Tensor, values: NDArray[np.float32]) -> float:
    """The largest difference between values in float32 and in float64, in some of the rows."""
    rows = slice(None, None, max(1, len(given) // ROUNDED))
    exact = deepcopy(network).double()(given[rows].double()).numpy()
    return float(np.abs(values[rows] - exact).max(initial=0.0))


def _serialised(
    network: Sequential,
    facts: dict[str, str],
    shape: tuple[int, ...],
    masked: bool,
    lstm: LSTM | None,
    stochastic: bool,
    given: Given,
    actions: ActionsLike,
    style: int,
) -> bytes:
    after = [type(module) for module in network if type(module) in _STEPS]
    width, graph = layers_of(network)[-1][1].size, Graph()
    graph.inputs.append(port("observations", "batch", *shape))
    graph.outputs.append(port("values", "batch", width))
    last = given.add_to(graph, graph.add("Flatten", ["observations"], "flat", axis=1))
    if style:
        graph.inputs.append(port(STYLE_INPUT, "batch", style))
        last = graph.add("Concat", [last, STYLE_INPUT], "in_style", axis=1)
    if lstm:
        graph.arrays["time"] = np.array([0])
        last = graph.add("Unsqueeze", [last, "time"], "sequence")
        for index in range(lstm.num_layers):
            last = _add_cells(graph, lstm, index, last)
        last = graph.add("Squeeze", [last, "time"], "remembered")
    # The names of the values before and after each step that follows the layers.
    ends = [*["unmasked"] * masked, *["logits"] * stochastic, "values"]
    layers = layers_of(network)
    for index, (weight, bias) in enumerate(layers):
        parameters = [f"weight_{index}", f"bias_{index}"]
        graph.arrays.update(zip(parameters, (weight, bias), strict=True))
        final, activated = index == len(layers) - 1, index < len(after)
        out = ends[0] if final and not activated else f"linear_{index}"
        last = graph.add("Gemm", [last, *parameters], out, transB=1)
        if activated:
            last = _activated(graph, after[index], last, ends[0] if final else f"hidden_{index}")
    if masked:
        graph.inputs.append(port(MASK_INPUT, "batch", width))
        graph.constants.update(one=1.0, masked=MASKED)
        graph.add("Sub", [MASK_INPUT, "one"], "closed")
        graph.add("Mul", ["closed", "masked"], "lost")
        graph.add("Add", [ends[0], "lost"], ends[1])
    if stochastic:
        # With -log(-log(u)) added, each logit is the largest with its probability (Gumbel-max).
        graph.inputs.append(port(NOISE_INPUT, "batch", width))
        graph.constants.update(DRAW_RANGE)
        graph.add("Clip", [NOISE_INPUT, "smallest", "largest"], "drawn")
        graph.add("Log", ["drawn"], "log_drawn")
        graph.add("Neg", ["log_drawn"], "exponential")
        graph.add("Log", ["exponential"], "log_exponential")
        graph.add("Sub", [ends[-2], "log_exponential"], "values")
    constants = {name: np.array(value, np.float32) for name, value in graph.constants.items()}
    arrays = graph.arrays | constants
    tensors = [numpy_helper.from_array(array, name) for name, array in arrays.items()]
    exported = helper.make_model(
        helper.make_graph(graph.nodes, "policy", graph.inputs, graph.outputs, tensors),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    own = meta_actions_of(actions)
    said = metadata_of(own) if own else {"actions": "continuous"}
    helper.set_model_props(exported, {"actions": said.pop("actions"), **facts, **said})
    onnx.checker.check_model(exported, full_check=True)
    data: bytes = exported.SerializeToString(deterministic=True)
    return data


def _activated(graph: Graph, kind: type[Module], x: str, result: str) -> str:
    """Adds an activation of `x`, and returns its result."""
    names, steps = {"x": x}, _STEPS[kind]
    for number, (operator, inputs) in enumerate(steps):
        taken = [names[each] if isinstance(each, str) else graph.constant(each) for each in inputs]
        out = result if number == len(steps) - 1 else f"{result}_{number}"
        names[operator] = graph.add(operator, taken, out)
    return result


def _add_cells(graph: Graph, lstm: LSTM, index: int, last: str) -> str:
    """Adds a layer of an LSTM, which takes (1, batch, width), and its states; returns `h`."""
    units = lstm.hidden_size
    gates = (
        getattr(lstm, f"{part}_l{index}").detach().numpy().reshape(4, units, -1)
        for part in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    )
    # torch has the gates input, forget, cell, output; ONNX has input, output, forget, cell.
    w, r, *biases = (each[[0, 3, 1, 2]].reshape(1, 4 * units, -1) for each in gates)
    weights = [f"lstm_{index}_{part}" for part in ("input", "recurrent", "bias")]
    arrays = (w, r, np.concatenate(biases, axis=1)[..., 0])
    graph.arrays.update(zip(weights, arrays, strict=True))
    before, then = [f"h_{index}", f"c_{index}"], [f"next_h_{index}", f"next_c_{index}"]
    taken = [last, *weights, "", *before]
    graph.nodes.append(helper.make_node("LSTM", taken, ["", *then], hidden_size=units))
    graph.inputs.extend(port(name, 1, "batch", units) for name in before)
    graph.outputs.extend(port(name, 1, "batch", units) for name in then)
    return then[0]


def write_manifest(path: Path, manifest: Mapping[str, Any]) -> None:
    """Writes what a network depends on and how it was made, one line for each key."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in manifest.items()]
    write_bytes(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())
