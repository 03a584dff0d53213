"""Exports a trained network to an ONNX file, and checks that the file acts the same."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from torch.nn import Sequential

from charms_agents.training.network import ACTIVATIONS, layers_of, values_of
from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.world.actions import ACTIONS
from charms_bench.world.files import write_atomically
from charms_bench.world.kinematics import Kinematics
from charms_bench.world.observations import Neighbours, described, neighbours
from charms_bench.world.scene import Observations

OPSET, IR_VERSION = 17, 8
"""Old versions, which every onnxruntime that the base install allows can read."""
TIE = 1e-4
"""Two actions whose values differ by less are equally good to float32's precision."""


def export(
    network: Sequential,
    path: Path,
    facts: dict[str, str],
    observations: Observations,
    observation: Neighbours | Kinematics = neighbours,
) -> dict[str, int]:
    """Writes a network as an ONNX file that `OnnxPolicy` runs.

    Args:
        network: Linear layers with ReLU or tanh between them.
        path: The file.
        facts: Further metadata, beside the observation and the actions.
        observations: (M, rows, columns) on which the file's actions are compared with the
            network's.
        observation: The kind of these observations.

    Returns:
        observations, the number compared; ties, the number in which the file chose a different
        action of equal value to float32's precision.

    Raises:
        ModelError: The file chose a worse action than the network; nothing is written.
        RunFolderError: The file cannot be written.
    """
    data = _serialised(network, {"observation": described(observation), **facts}, observation.shape)
    expected = values_of(network, observations)
    best = expected.argmax(axis=1)
    checked: dict[str, int] = {}

    def write(partial: Path) -> None:
        partial.write_bytes(data)
        found = OnnxPolicy(partial).decide(observations)
        lost = expected.max(axis=1) - expected[np.arange(found.size), found]
        if count := int((lost > TIE).sum()):
            raise ModelError(
                f"{path}: would act differently from the network in {count} of {found.size} "
                "observations; onnxruntime and torch disagree on this machine"
            )
        checked.update(observations=int(found.size), ties=int((found != best).sum()))

    write_atomically(path, write)
    return checked


def _serialised(network: Sequential, facts: dict[str, str], shape: tuple[int, int]) -> bytes:
    layers = layers_of(network)
    operators = {kind: name for name, kind in ACTIVATIONS.items()}
    between = [operators[type(module)] for module in network if type(module) in operators]
    nodes, tensors, last = [], [], "flat"
    nodes.append(helper.make_node("Flatten", ["observations"], ["flat"], axis=1))
    for index, (weight, bias) in enumerate(layers):
        tensors.append(numpy_helper.from_array(weight, f"weight_{index}"))
        tensors.append(numpy_helper.from_array(bias, f"bias_{index}"))
        final = index == len(layers) - 1
        out = "values" if final else f"linear_{index}"
        inputs = [last, f"weight_{index}", f"bias_{index}"]
        nodes.append(helper.make_node("Gemm", inputs, [out], transB=1))
        if not final:
            nodes.append(helper.make_node(between[index], [out], [f"hidden_{index}"]))
            last = f"hidden_{index}"
    seen = helper.make_tensor_value_info("observations", TensorProto.FLOAT, ["batch", *shape])
    valued = helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", len(ACTIONS)])
    graph = helper.make_graph(nodes, "policy", [seen], [valued], tensors)
    exported = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
    )
    helper.set_model_props(exported, {"actions": ", ".join(ACTIONS), **facts})
    onnx.checker.check_model(exported, full_check=True)
    data: bytes = exported.SerializeToString(deterministic=True)
    return data
