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
from charms_bench.plugins import onnx_policy, onnx_session  # noqa: E402
from charms_bench.plugins.onnx_file import problem_of  # noqa: E402
from charms_bench.plugins.onnx_policy import OnnxPolicy  # noqa: E402


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


def divided(by: int) -> bytes:
    """A network that divides the smallest integer."""
    nodes = [
        helper.make_node("Div", ["smallest", "by"], ["quotient"]),
        helper.make_node("Cast", ["quotient"], ["large"], to=TensorProto.FLOAT),
    ]
    smallest = np.array([np.iinfo(np.int64).min])
    return model(nodes, smallest=smallest, by=np.array([by]))


def test_a_network_that_ends_its_process_ends_only_the_worker() -> None:
    with pytest.raises(ModelError, match=r"ends its process when it is tried \(SIGFPE"):
        onnx_session.tried(divided(by=-1))
    assert onnx_session.tried(divided(by=4)).problem == ""


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


def test_a_network_makes_no_texts() -> None:
    nodes = [
        helper.make_node("Cast", ["observations"], ["text"], to=TensorProto.STRING),
        helper.make_node("Cast", ["text"], ["large"], to=TensorProto.FLOAT),
    ]
    assert problem_of(model(nodes)) == "has texts among its tensors"


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
