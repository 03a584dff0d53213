"""Networks are tried in a worker before this process opens them."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402

from charms_bench.errors import ModelError  # noqa: E402
from charms_bench.foundation.workers import Died  # noqa: E402
from charms_bench.plugins import onnx_file, onnx_policy, onnx_session  # noqa: E402
from charms_bench.plugins.onnx_file import problem_of  # noqa: E402
from charms_bench.plugins.onnx_policy import OnnxPolicy  # noqa: E402

SMALLEST = np.array([np.iinfo(np.int64).min])


def model(nodes: Sequence[Any], **constants: Any) -> bytes:
    """A network of `weights`, these constants, and nodes that make `large`, which is added."""
    arrays = {"weights": np.ones((35, 5), np.float32), **constants}
    graph = helper.make_graph(
        [
            helper.make_node("MatMul", ["observations", "weights"], ["hidden"]),
            *nodes,
            helper.make_node("Add", ["hidden", "large"], ["values"]),
        ],
        "policy",
        [helper.make_tensor_value_info("observations", TensorProto.FLOAT, ["batch", 35])],
        [helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", 5])],
        [numpy_helper.from_array(array, name) for name, array in arrays.items()],
    )
    opsets = [helper.make_opsetid("", 17)]
    data: bytes = helper.make_model(graph, opset_imports=opsets, ir_version=9).SerializeToString()
    return data


def division() -> bytes:
    return model(
        [
            helper.make_node("Div", ["smallest", "minus_one"], ["quotient"]),
            helper.make_node("Cast", ["quotient"], ["large"], to=TensorProto.FLOAT),
        ],
        smallest=SMALLEST,
        minus_one=np.array([-1]),
    )


def test_a_network_that_ends_its_process_ends_only_the_worker() -> None:
    with pytest.raises(ModelError, match=r"ends its process when it is tried \(SIGFPE"):
        onnx_session.tried(division())


def test_a_network_is_tried_once(
    network_file: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    ask = onnx_session.ask
    monkeypatch.setattr(onnx_session, "_signatures", {})
    monkeypatch.setattr(onnx_session, "ask", lambda *words: asked.append(1) or ask(*words))
    weights = np.ones((35, 5))
    first, second = (network_file(weights, name=name) for name in ("one.onnx", "two.onnx"))
    for path in (first, second, first):
        OnnxPolicy(path)
    assert len(asked) == 1


def test_this_process_opens_a_network_only_when_it_decides(
    network_file: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def open_session(data: bytes) -> Any:
        raise AssertionError("opened")

    monkeypatch.setattr(onnx_policy, "open_session", open_session)
    policy = OnnxPolicy(network_file())
    with pytest.raises(AssertionError, match="opened"):
        policy.decide(np.zeros((2, 7, 5), np.float32))


@pytest.mark.parametrize(
    ("died", "message"),
    [
        (Died(None), "takes more than 5 s of processor time"),
        (Died(-signal.SIGXCPU), "takes more than 5 s of processor time"),
        (Died(-signal.SIGKILL), "SIGKILL, as when memory runs out"),
        (Died(-signal.SIGSEGV), "ends its process when it is tried .SIGSEGV"),
        (Died(1), "ends its process when it is tried .without a signal"),
    ],
)
def test_whatever_ends_the_worker_is_said_with_the_file(
    network_file: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, died: Died, message: str
) -> None:
    def ask(*words: object) -> None:
        raise died

    path = network_file()
    monkeypatch.setattr(onnx_session, "_signatures", {})
    monkeypatch.setattr(onnx_session, "ask", ask)
    with pytest.raises(ModelError, match=f"policy.onnx: .*{message}"):
        OnnxPolicy(path)


OPERATORS_BEFORE = {
    "a cast": helper.make_node("Cast", ["observations"], ["dividend"], to=TensorProto.INT64),
    "a shape": helper.make_node("Shape", ["observations"], ["dividend"]),
    "a place": helper.make_node("ArgMax", ["observations"], ["dividend"]),
    "places": helper.make_node("TopK", ["observations", "k"], ["highest", "dividend"]),
    "a constant": helper.make_node("Constant", [], ["dividend"], value_int=7),
    "a choice": helper.make_node("Where", ["yes", "smallest", "k"], ["dividend"]),
    "nothing that is known": helper.make_node("Identity", ["later"], ["dividend"]),
}


@pytest.mark.parametrize("before", OPERATORS_BEFORE.values(), ids=OPERATORS_BEFORE.keys())
def test_integers_are_found_whatever_they_come_from(before: Any) -> None:
    nodes = [before, helper.make_node("Div", ["dividend", "k"], ["large"])]
    data = model(nodes, smallest=SMALLEST, k=np.array([-1]), yes=np.array([True]))
    assert problem_of(data).startswith("divides integers")


def divided_by(constant: Any, **initializers: Any) -> bytes:
    shape = helper.make_node("Shape", ["observations"], ["dividend"])
    made = [constant] if constant else []
    return model([shape, *made, helper.make_node("Div", ["dividend", "k"], ["large"])],
                 **initializers)  # fmt: skip


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.int64, np.uint64])
def test_integers_are_divided_by_constants_other_than_0_and_minus_1(dtype: Any) -> None:
    assert problem_of(divided_by(None, k=np.array([4, 7], dtype))) == ""
    for bad in (0, np.iinfo(dtype).max if np.iinfo(dtype).min == 0 else -1):
        data = divided_by(None, k=np.array([4, bad], dtype))
        assert problem_of(data).startswith("divides integers")


@pytest.mark.parametrize(
    ("values", "is_safe"),
    [([4], True), ([-1], False), ([0], False), ([2**32], False), ([2**32 - 1], False), ([], False)],
)
def test_the_stored_values_of_a_constant_count(values: list[int], is_safe: bool) -> None:
    tensor = TensorProto(data_type=TensorProto.INT32, dims=[1]).SerializeToString()
    packed = b"".join(_encoded(value % 2**64) for value in values)
    written = tensor + b"\x2a" + bytes([len(packed)]) + packed  # int32_data
    message = onnx_file.Reader().read(memoryview(written), onnx_file._TENSOR)
    assert onnx_file._is_safe(message) == is_safe


def _encoded(value: int) -> bytes:
    """A number with seven bits per byte."""
    data = bytearray()
    while True:
        data.append(value & 0x7F | (0x80 if value > 0x7F else 0))
        value >>= 7
        if not value:
            return bytes(data)


def test_a_constant_that_an_input_replaces_does_not_count() -> None:
    nodes = [
        helper.make_node("Shape", ["observations"], ["dividend"]),
        helper.make_node("Div", ["dividend", "k"], ["large"]),
    ]
    loaded = onnx.load_from_string(model(nodes, k=np.array([4])))
    loaded.graph.input.append(helper.make_tensor_value_info("k", TensorProto.INT64, [1]))
    assert problem_of(loaded.SerializeToString()).startswith("divides integers")


def test_a_network_makes_no_texts() -> None:
    nodes = [
        helper.make_node("Cast", ["observations"], ["text"], to=TensorProto.STRING),
        helper.make_node("Cast", ["text"], ["large"], to=TensorProto.FLOAT),
    ]
    assert problem_of(model(nodes)) == "has texts among its tensors"


def test_floating_point_numbers_are_divided() -> None:
    nodes = [
        helper.make_node("ReduceMean", ["observations"], ["mean"], axes=[1]),
        helper.make_node("Sub", ["observations", "mean"], ["centred"]),
        helper.make_node("Constant", [], ["two"], value_float=2.0),
        helper.make_node("Div", ["centred", "two"], ["half"]),
        helper.make_node("Div", ["ones", "two"], ["halves"]),
        helper.make_node("Cast", ["counts"], ["casts"], to=TensorProto.FLOAT),
        helper.make_node("Div", ["casts", "two"], ["large"]),
    ]
    data = model(nodes, ones=np.ones(5, np.float32), counts=np.arange(5))
    assert problem_of(data) == ""


HANGS = """\
import signal
from charms_bench.cli import main, terminal

@terminal.app.command()
def hang() -> None:
    print("begun", flush=True)
    signal.signal(signal.SIGINT, lambda number, frame: None)  # as if a library computed for hours
    while True:
        pass

main()
"""


def test_a_second_ctrl_c_ends_a_command_that_does_not_react() -> None:
    command = [sys.executable, "-c", HANGS, "hang"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout is not None
    assert running.stdout.readline() == "begun\n"
    for _ in range(2):
        time.sleep(0.3)
        os.kill(running.pid, signal.SIGINT)
    assert running.communicate(timeout=60)[1] == "interrupted again; ended at once\n"
    assert running.returncode == 128 + signal.SIGINT
