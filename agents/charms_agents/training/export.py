"""A trained network -> one ONNX file that `OnnxPolicy` runs, and the check that it is the same."""

from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch.nn import Linear

from charms_agents.training.double_dqn import DoubleDQN
from charms_bench.agent import ACTIONS
from charms_bench.errors import ModelError
from charms_bench.onnx_policy import OnnxPolicy
from charms_bench.results import write_atomically

OPSET, IR_VERSION = 17, 8
"""Old ones: every onnxruntime the base install allows reads them."""
TIE = 1e-4
"""Two actions whose values differ by less are as good as each other to float32."""
OBSERVATION = (
    "neighbours: (7, 5) float32, rows self, left front, left rear, front, rear, right front, "
    "right rear; columns presence, x / 165 m, y / 12 m, vx / 66 m/s, vy / 66 m/s"
)


def export(model: DoubleDQN, path: Path, facts: dict[str, str]) -> None:
    """Writes the online network; `facts` go into the file's metadata."""
    layers = [
        (module.weight.detach().numpy(), module.bias.detach().numpy())
        for module in model.q_net.q_net
        if isinstance(module, Linear)
    ]
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
            nodes.append(helper.make_node("Relu", [out], [f"hidden_{index}"]))
            last = f"hidden_{index}"
    seen = helper.make_tensor_value_info("observations", TensorProto.FLOAT, ["batch", 7, 5])
    valued = helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", len(ACTIONS)])
    graph = helper.make_graph(nodes, "policy", [seen], [valued], tensors)
    exported = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
    )
    helper.set_model_props(
        exported, {"observation": OBSERVATION, "actions": ", ".join(ACTIONS), **facts}
    )
    onnx.checker.check_model(exported, full_check=True)
    data = exported.SerializeToString(deterministic=True)
    write_atomically(path, lambda partial: partial.write_bytes(data))


def recorded_observations(model: DoubleDQN) -> NDArray[np.float32]:
    """What the agent saw in its last steps: all its replay buffer holds, (M, 7, 5)."""
    buffer = model.replay_buffer
    assert buffer is not None
    observations: NDArray[np.float32] = buffer.observations[: buffer.size()].reshape(-1, 7, 5)
    return observations


def check_export(model: DoubleDQN, path: Path) -> dict[str, int]:
    """Compares the file's actions with the network's on everything recorded.

    Returns:
        How many observations were compared, and in how many of them the two chose different
        actions whose values are equal to float32's precision.

    Raises:
        ModelError: They chose differently where it matters.
    """
    observations = recorded_observations(model)
    expected = model.values(observations)
    best, found = expected.argmax(axis=1), OnnxPolicy(path).decide(observations)
    lost = expected.max(axis=1) - expected[np.arange(found.size), found]
    if (lost > TIE).any():
        count = int((lost > TIE).sum())
        raise ModelError(
            f"{path}: acts differently from the trained network in {count} of {found.size} "
            "observations; onnxruntime and torch disagree on this machine"
        )
    return {"observations": int(found.size), "ties": int((found != best).sum())}
