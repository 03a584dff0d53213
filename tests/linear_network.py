"""An ONNX file of one linear layer, for tests that need a network."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest


def linear_network(
    path: Path,
    weights: "np.ndarray | None" = None,
    *,
    batch: str | int = "batch",
    inputs: int = 35,
    dtype: int = 1,
    metadata: dict[str, str] | None = None,
) -> Path:
    """Writes the file; the weights, (35, 5) by default, are drawn unless they are given."""
    onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")
    helper: Any = onnx.helper
    inputs = inputs if weights is None else len(weights)
    if weights is None:
        weights = np.random.default_rng(0).normal(size=(inputs, 5))
    layer = weights.astype(helper.tensor_dtype_to_np_dtype(dtype))
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observations", "weights"], ["values"])],
        "policy",
        [helper.make_tensor_value_info("observations", dtype, [batch, inputs])],
        [helper.make_tensor_value_info("values", dtype, [batch, weights.shape[1]])],
        [onnx.numpy_helper.from_array(layer, "weights")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, metadata or {})
    onnx.save(model, path)
    return path
