"""Checks what an ONNX file contains before onnxruntime loads it.

Only the fields that matter here are read, by their numbers in `onnx.proto`.
"""

from collections.abc import Iterator

from charms_bench.plugins.onnx_types import divides_integers
from charms_bench.plugins.protobuf import (
    FIELDS_LIMIT,
    Fields,
    TooManyFieldsError,
    message_of,
    text_of,
)

_ARITHMETIC = (
    "Abs Add And ArgMax ArgMin AveragePool BatchNormalization Cast Ceil Celu Clip Concat Constant "
    "ConstantOfShape Conv Cos CumSum Div Dropout Einsum Elu Equal Erf Exp Expand Flatten Floor GRU "
    "Gather GatherElements GatherND Gelu Gemm GlobalAveragePool GlobalMaxPool Greater "
    "GreaterOrEqual HardSigmoid HardSwish Identity InstanceNormalization LSTM LayerNormalization "
    "LeakyRelu Less LessOrEqual Log LogSoftmax LpNormalization MatMul Max MaxPool Mean Min Mish "
    "Mod Mul Neg Not OneHot Or PRelu Pad Pow RMSNormalization RNN Range Reciprocal ReduceL1 "
    "ReduceL2 ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare "
    "Relu Reshape Round ScatterElements ScatterND Selu Shape Sigmoid Sign Sin Size Slice Softmax "
    "Softplus Softsign Split Sqrt Squeeze Sub Sum Swish Tanh ThresholdedRelu Tile TopK Transpose "
    "Trilu Unsqueeze Where Xor"
)
OPERATORS = frozenset(_ARITHMETIC.split())
"""The operators that a policy may have: no loops, random numbers, texts or custom code."""

NODES_LIMIT = 10_000
"""onnxruntime takes about a second to load so many."""

_GRAPH, _FUNCTIONS = 7, 25  # of a model
_NODE, _INITIALIZER, _SPARSE_INITIALIZER = 1, 5, 15  # of a graph
_OPERATOR, _ATTRIBUTE, _DOMAIN = 4, 5, 7  # of a node
_TENSOR, _SUBGRAPH, _TENSORS, _SUBGRAPHS, _SPARSE = 5, 6, 10, 11, (22, 23)  # of an attribute
_TEXTS = {b"value_string", b"value_strings"}  # names of attributes
_DATA_TYPE, _EXTERNAL_DATA, _DATA_LOCATION = 2, 13, 14  # of a tensor
_STRING = 8


def problem_of(data: bytes) -> str:
    """Why a file must not be loaded; empty if the file passes all checks."""
    try:
        problem = next(_problems(memoryview(data), Fields()), "")
        if not problem and divides_integers(memoryview(data)):
            problem = "divides integers (Div or Mod), which can end the process; divide floats"
        return problem
    except TooManyFieldsError:
        return f"has more than {FIELDS_LIMIT:,} fields; a policy is far smaller"
    except (IndexError, ValueError):
        return "is not an ONNX file, or is damaged"


def _problems(model: memoryview, fields: Fields) -> Iterator[str]:
    nodes = 0
    for number, graph in fields.of(model):
        if number == _FUNCTIONS:
            yield "has functions; save it with all functions inlined"
        if number != _GRAPH:
            continue
        for kind, value in fields.of(message_of(graph)):
            if kind == _NODE:
                nodes += 1
                if nodes > NODES_LIMIT:
                    yield f"has more than {NODES_LIMIT:,} nodes; a policy is far smaller"
                yield from _problems_of_node(message_of(value), fields)
            elif kind == _INITIALIZER:
                yield from _problems_of_tensor(message_of(value), fields)
            elif kind == _SPARSE_INITIALIZER:
                yield "has sparse tensors; save it with dense ones"


def _problems_of_node(node: memoryview, fields: Fields) -> Iterator[str]:
    parts = list(fields.of(node))
    domains = [text_of(value) for number, value in parts if number == _DOMAIN]
    for name in (text_of(value) for number, value in parts if number == _OPERATOR):
        if name not in OPERATORS or any(domain not in ("", "ai.onnx") for domain in domains):
            full = ".".join(filter(None, (*domains, name)))
            yield f"has the operator '{full[:80]}'; a policy may only have ONNX's arithmetic"
    for number, attribute in parts:
        if number != _ATTRIBUTE:
            continue
        for kind, value in fields.of(message_of(attribute)):
            if kind in (_TENSOR, _TENSORS):
                yield from _problems_of_tensor(message_of(value), fields)
            elif kind in (_SUBGRAPH, _SUBGRAPHS):
                yield "has graphs within its graph"
            elif kind in _SPARSE:
                yield "has sparse tensors; save it with dense ones"
            elif isinstance(value, memoryview) and bytes(value[:16]) in _TEXTS:
                yield "has texts among its tensors"


def _problems_of_tensor(tensor: memoryview, fields: Fields) -> Iterator[str]:
    for number, value in fields.of(tensor):
        if number == _EXTERNAL_DATA or (number == _DATA_LOCATION and value):
            yield "keeps tensors in other files; save it as a single file"
        if number == _DATA_TYPE and value == _STRING:
            yield "has texts among its tensors"
