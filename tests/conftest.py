"""What tests share: small networks as ONNX files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def network_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes an ONNX file of one linear layer; its weights (35, 5) may be given."""
    onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")
    helper, numpy_helper = onnx.helper, onnx.numpy_helper

    def write(
        weights: np.ndarray | None = None,
        *,
        name: str = "policy.onnx",
        batch: str | int = "batch",
        inputs: int = 35,
        dtype: int = onnx.TensorProto.FLOAT,
    ) -> Path:
        if weights is None:
            weights = np.random.default_rng(0).normal(size=(inputs, 5))
        element = onnx.helper.tensor_dtype_to_np_dtype(dtype)
        graph = helper.make_graph(
            [helper.make_node("MatMul", ["observations", "weights"], ["values"])],
            "policy",
            [helper.make_tensor_value_info("observations", dtype, [batch, inputs])],
            [helper.make_tensor_value_info("values", dtype, [batch, weights.shape[1]])],
            [numpy_helper.from_array(weights.astype(element), "weights")],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
        path = tmp_path / name
        onnx.save(model, path)
        return path

    return write
