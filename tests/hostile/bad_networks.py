"""ONNX files that read other files, run without end, or are not what they claim to be."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from bad_input import BadInput
from onnx import TensorProto, helper, numpy_helper

FLOAT = TensorProto.FLOAT
WEIGHTS = numpy_helper.from_array(np.ones((35, 5), dtype=np.float32), "weights")
LINEAR = helper.make_node("MatMul", ["observations", "weights"], ["values"])
HIDDEN = helper.make_node("MatMul", ["observations", "weights"], ["hidden"])


def network(
    nodes: Sequence[Any] = (LINEAR,),
    tensors: Sequence[Any] = (WEIGHTS,),
    seen: Sequence[Any] = ("batch", 35),
    valued: Sequence[Any] = ("batch", 5),
    kind: int = FLOAT,
    out: int | None = None,
    facts: dict[str, str] | None = None,
    **more: Any,
) -> Any:
    """A model, by default a valid one with one linear layer."""
    graph = helper.make_graph(
        list(nodes),
        "policy",
        [helper.make_tensor_value_info("observations", kind, list(seen))],
        [helper.make_tensor_value_info("values", out or kind, list(valued))],
        list(tensors),
        **more,
    )
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("com.example", 1)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=9)
    helper.set_model_props(model, facts or {})
    return model


def with_port(name: str, shape: Sequence[Any], following: bool = False) -> Any:
    """A model with one more input, and perhaps an output of the same shape."""
    model = network()
    model.graph.input.append(helper.make_tensor_value_info(name, FLOAT, shape))
    if following:
        model.graph.output.append(helper.make_tensor_value_info("next", FLOAT, shape))
        model.graph.node.append(helper.make_node("Identity", [name], ["next"]))
    return model


def outside(place: str) -> Any:
    """A model whose weights are in another file."""
    tensor = TensorProto(name="weights", data_type=FLOAT, dims=[35, 5])
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=place)
    return network(tensors=[tensor])


def disguised(place: str) -> bytes:
    """The same, encoded so that no search for bytes finds the name of the file."""
    plain = outside(place).SerializeToString()
    entry = b"\x0a\x08location\x12" + bytes([len(place)]) + place.encode()
    other = b"\x12" + bytes([len(place)]) + place.encode() + b"\x0a\x08location"
    assert plain.count(entry) == 1
    return plain.replace(entry, other)


def announced(*dims: int, data: bytes = b"") -> Any:
    return network(tensors=[TensorProto(name="weights", data_type=FLOAT, dims=dims, raw_data=data)])


def added(*nodes: Any, tensors: Sequence[Any] = (), **more: Any) -> Any:
    """A linear layer to which the sum of something called `large` is added."""
    total = helper.make_node("ReduceSum", ["large"], ["total"], keepdims=0)
    sum_ = helper.make_node("Add", ["hidden", "total"], ["values"])
    return network([HIDDEN, *nodes, total, sum_], [WEIGHTS, *tensors], **more)


def constant(name: str, values: Any) -> Any:
    return numpy_helper.from_array(np.asarray(values), name)


def sparse(length: int) -> Any:
    one = numpy_helper.from_array(np.ones(1, dtype=np.float32), "large")
    at = numpy_helper.from_array(np.zeros(1, dtype=np.int64), "places")
    return helper.make_sparse_tensor(one, at, [length])


def endless() -> Any:
    inner = [
        helper.make_node("Identity", ["again"], ["goes_on"]),
        helper.make_node("Identity", ["before"], ["after"]),
    ]
    info = helper.make_tensor_value_info
    body = helper.make_graph(
        inner,
        "body",
        [
            info("i", TensorProto.INT64, []),
            info("again", TensorProto.BOOL, []),
            info("before", FLOAT, ["batch", 5]),
        ],
        [info("goes_on", TensorProto.BOOL, []), info("after", FLOAT, ["batch", 5])],
    )
    loop = helper.make_node("Loop", ["times", "first", "hidden"], ["values"], body=body)
    tensors = [WEIGHTS, constant("times", np.int64(2**62)), constant("first", True)]
    return network([HIDDEN, loop], tensors)


def long_product(is_constant: bool) -> Any:
    """200 products of matrices of 256 MB, of constants or of what is seen, in a file of 6 KB."""
    nodes = [helper.make_node("ConstantOfShape", ["size"], ["zeros"])]
    total = helper.make_node("ReduceSum", ["observations"], ["seen"], keepdims=0)
    nodes += [] if is_constant else [total, helper.make_node("Add", ["zeros", "seen"], ["power0"])]
    first = "zeros" if is_constant else "power0"
    names = [first, *(f"power{k}" for k in range(1, 200)), "large"]
    nodes += [
        helper.make_node("MatMul", [before, first], [after]) for before, after in pairwise(names)
    ]
    return added(*nodes, tensors=[constant("size", np.array([8192, 8192]))])


def chain(length: int) -> list[Any]:
    """That many nodes after `hidden`."""
    names = ["hidden", *(f"link{k}" for k in range(1, length + 1))]
    return [helper.make_node("Neg", [before], [after]) for before, after in pairwise(names)]


def nested(depth: int) -> bytes:
    """Attributes in nodes in graphs in attributes, far deeper than any parser should go."""
    data = b""
    for _ in range(depth):
        for tag in (b"\x32", b"\x2a", b"\x0a"):  # g of an attribute, of a node, of a graph
            size, length = len(data), b""
            while size > 127:
                length, size = length + bytes([size & 127 | 128]), size >> 7
            data = tag + length + bytes([size]) + data
    return (
        b"\x3a"
        + bytes([0x80 | len(data) & 127, len(data) >> 7 & 127 | 128, len(data) >> 14])
        + data
    )


def one_node(operator: str, domain: str = "", **attributes: Any) -> Any:
    node = helper.make_node(operator, ["observations"], ["values"], domain=domain, **attributes)
    return network([node])


def with_function() -> Any:
    model = network()
    inner = [helper.make_node("Identity", ["a"], ["b"])]
    opsets = [helper.make_opsetid("", 17)]
    model.functions.append(helper.make_function("com.example", "Mine", ["a"], ["b"], inner, opsets))
    return model


MODELS: dict[str, Callable[[], Any]] = {
    "weights elsewhere, disguised": lambda: disguised("suite.yaml"),
    "weights elsewhere, in a node": lambda: added(
        helper.make_node(
            "Constant", [], ["large"], value=outside("suite.yaml").graph.initializer[0]
        )
    ),
    "weights of a terabyte, announced": lambda: announced(2**20, 2**20, data=bytes(8)),
    "weights of nothing": lambda: announced(35, 0),
    "zeros of 64 GiB": lambda: added(
        helper.make_node("ConstantOfShape", ["size"], ["large"]),
        tensors=[constant("size", np.array([2**34]))],
    ),
    "a product of 80 GB": lambda: added(
        helper.make_node("MatMul", ["tall", "wide"], ["large"]),
        tensors=[
            constant("tall", np.ones((140_000, 1), np.float32)),
            constant("wide", np.ones((1, 140_000), np.float32)),
        ],
    ),
    "a sparse tensor of 32 GiB": lambda: added(sparse_initializer=[sparse(2**33)]),
    "a sparse constant of 32 GiB": lambda: added(
        helper.make_node("Constant", [], ["large"], sparse_value=sparse(2**33))
    ),
    "a loop without end": endless,
    "somebody's own operator": lambda: one_node("Evil", "com.example"),
    "chance": lambda: one_node("RandomNormalLike"),
    "texts": lambda: added(helper.make_node("Constant", [], ["large"], value_string="x" * 1000)),
    "functions": with_function,
    "a product of hours when it is loaded": lambda: long_product(is_constant=True),
    "a product of hours when it is computed": lambda: long_product(is_constant=False),
    "the smallest integer divided by -1": lambda: added(
        helper.make_node("Div", ["smallest", "minus_one"], ["quotient"]),
        helper.make_node("Cast", ["quotient"], ["large"], to=FLOAT),
        tensors=[constant("smallest", [np.iinfo(np.int64).min]), constant("minus_one", [-1])],
    ),
    "an integer divided by an observation": lambda: added(
        helper.make_node("Cast", ["observations"], ["seen"], to=TensorProto.INT64),
        helper.make_node("Mod", ["smallest", "seen"], ["rest"]),
        helper.make_node("Cast", ["rest"], ["large"], to=FLOAT),
        tensors=[constant("smallest", [np.iinfo(np.int64).min])],
    ),
    "100,000 nodes": lambda: network(
        [HIDDEN, *chain(100_000), helper.make_node("Identity", ["link100000"], ["values"])]
    ),
    "a million empty fields": lambda: b"\x3a\xc8\x8a\x7a" + b"\x6a\x00" * 1_000_100,
    "a fixed batch": lambda: network(seen=(1, 35)),
    "doubles": lambda: network(kind=TensorProto.DOUBLE),
    "more values than vehicles": lambda: network(
        [HIDDEN, helper.make_node("Concat", ["hidden", "hidden"], ["values"], axis=0)],
        valued=("many", 5),
    ),
    "10^9 random numbers": lambda: with_port("noise", ["batch", 10**9]),
    "nested 10,000 deep": lambda: nested(10_000),
    "a text": lambda: b"not a network",
    "half a file": lambda: network().SerializeToString()[:-200],
}  # fmt: skip


SAID = {
    "weights elsewhere, in a node": "keeps tensors in other files",
    "a sparse constant of 32 GiB": "has sparse tensors",
    "somebody's own operator": "has the operator 'com.example.Evil'",
    "chance": "has the operator 'RandomNormalLike'",
    "texts": "has texts among its tensors",
    "functions": "has functions; save it",
    "an integer divided by an observation": "cannot be computed",
    "100,000 nodes": "has more than 10,000 nodes",
    "a million empty fields": "fields; a policy is far smaller",
    "a fixed batch": "expected one float32 input",
    "doubles": "cannot be loaded by onnxruntime",
    "more values than vehicles": "returns values of shape (128, 5); expected (64, 5)",
    "10^9 random numbers": "with at most 4,096 numbers",
    "nested 10,000 deep": "has graphs within its graph",
    "a text": "is not an ONNX file, or is damaged",
    "half a file": "is not an ONNX file, or is damaged",
}
"""Words of the message about some of them."""


def _bad(title: str, model: Callable[[], Any]) -> BadInput:
    def make(folder: Path) -> Sequence[str]:
        made = model()
        data = made if isinstance(made, bytes) else made.SerializeToString()
        (folder / "policy.onnx").write_bytes(data)
        return "check", "policy.onnx"

    return BadInput(f"network: {title}", make, SAID.get(title, ""))


CASES = tuple(_bad(*item) for item in MODELS.items())
