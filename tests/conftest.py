"""What tests share: one thread per library, workers without processes, small networks."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import numpy as np

# NumPy, numba and Polars read these once, when they are imported.
for variable in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "POLARS_MAX_THREADS"):
    os.environ.setdefault(variable, "1")


@pytest.fixture(scope="session", autouse=True)
def _one_worker_is_this_process() -> Iterator[None]:
    """Runs with `workers=1` simulate in the test process, which saves the start of a worker.

    The reference engine still gets a worker of its own, because NumPy has to start with other
    settings for it. Tests of the workers themselves start theirs.
    """
    from charms_bench.errors import CharmsBenchError
    from charms_bench.runs import runner

    in_processes = runner.in_processes

    def here(work: Callable[..., Any], tasks: list[Any], count: int, *others: Any) -> Iterator[Any]:
        if count != 1 or any(getattr(each, "engine", "") == "highway-env" for each in tasks):
            yield from in_processes(work, tasks, count, *others)
            return
        failed, dropped = others[4], set[Any]()
        for task in tasks:
            try:
                if task not in dropped:
                    yield task, work(task)
            except CharmsBenchError as error:
                if failed is None:
                    raise
                dropped |= failed(task, error)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "in_processes", here)
        yield


@pytest.fixture
def network_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes an ONNX file of one linear layer; its weights (35, 5) may be given."""
    import numpy as np

    onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")
    helper, numpy_helper = onnx.helper, onnx.numpy_helper

    def write(
        weights: "np.ndarray | None" = None,
        *,
        name: str = "policy.onnx",
        batch: str | int = "batch",
        inputs: int = 35,
        dtype: int = onnx.TensorProto.FLOAT,
        metadata: dict[str, str] | None = None,
    ) -> Path:
        inputs = inputs if weights is None else len(weights)
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
        helper.set_model_props(model, metadata or {})
        path = tmp_path / name
        onnx.save(model, path)
        return path

    return write
