"""Checks what an ONNX file contains before onnxruntime loads it.

The format is Protocol Buffers: a message is a sequence of fields; each has a number, a kind and a
value, and a value can be a message itself. Only the fields that matter here are read, by their
numbers in `onnx.proto`. https://protobuf.dev/programming-guides/encoding/
"""

from collections.abc import Iterator

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
FIELDS_LIMIT = 1_000_000
"""Fields in all messages together that are read; a network of ten layers has about 300."""

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
        return next(_problems(memoryview(data), _Fields()), "")
    except _TooManyError:
        return f"has more than {FIELDS_LIMIT:,} fields; a policy is far smaller"
    except (IndexError, ValueError):
        return "is not an ONNX file, or is damaged"


def _problems(model: memoryview, fields: "_Fields") -> Iterator[str]:
    nodes = 0
    for number, graph in fields.of(model):
        if number == _FUNCTIONS:
            yield "has functions; save it with all functions inlined"
        if number != _GRAPH:
            continue
        for kind, value in fields.of(_message(graph)):
            if kind == _NODE:
                nodes += 1
                if nodes > NODES_LIMIT:
                    yield f"has more than {NODES_LIMIT:,} nodes; a policy is far smaller"
                yield from _problems_of_node(_message(value), fields)
            elif kind == _INITIALIZER:
                yield from _problems_of_tensor(_message(value), fields)
            elif kind == _SPARSE_INITIALIZER:
                yield "has sparse tensors; save it with dense ones"


def _problems_of_node(node: memoryview, fields: "_Fields") -> Iterator[str]:
    parts = list(fields.of(node))
    domains = [_text(value) for number, value in parts if number == _DOMAIN]
    for name in (_text(value) for number, value in parts if number == _OPERATOR):
        if name not in OPERATORS or any(domain not in ("", "ai.onnx") for domain in domains):
            full = ".".join(filter(None, (*domains, name)))
            yield f"has the operator '{full[:80]}'; a policy may only have ONNX's arithmetic"
    for number, attribute in parts:
        if number != _ATTRIBUTE:
            continue
        for kind, value in fields.of(_message(attribute)):
            if kind in (_TENSOR, _TENSORS):
                yield from _problems_of_tensor(_message(value), fields)
            elif kind in (_SUBGRAPH, _SUBGRAPHS):
                yield "has graphs within its graph"
            elif kind in _SPARSE:
                yield "has sparse tensors; save it with dense ones"
            elif isinstance(value, memoryview) and bytes(value[:16]) in _TEXTS:
                yield "has texts among its tensors"


def _problems_of_tensor(tensor: memoryview, fields: "_Fields") -> Iterator[str]:
    for number, value in fields.of(tensor):
        if number == _EXTERNAL_DATA or (number == _DATA_LOCATION and value):
            yield "keeps tensors in other files; save it as a single file"
        if number == _DATA_TYPE and value == _STRING:
            yield "has texts among its tensors"


class _TooManyError(Exception):
    pass


class _Fields:
    """The fields of messages, of which a file may have a limited number."""

    def __init__(self) -> None:
        self._left = FIELDS_LIMIT

    def of(self, message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
        """The number and value of each field.

        Raises:
            ValueError, IndexError: It is not a message.
        """
        at = 0
        while at < len(message):
            tag, at = _varint(message, at)
            number, kind = tag >> 3, tag & 7
            value: int | memoryview
            if kind == 0:
                value, at = _varint(message, at)
            elif kind in (1, 5):
                size = 8 if kind == 1 else 4
                value, at = message[at : at + size], at + size
            elif kind == 2:
                size, at = _varint(message, at)
                value, at = message[at : at + size], at + size
            else:
                raise ValueError(f"field {number} is of the kind {kind}")
            if at > len(message) or not 0 < number < 2**29:
                raise ValueError(f"field {number} is cut short")
            self._left -= 1
            if self._left < 0:
                raise _TooManyError
            yield number, value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number with seven bits per byte, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & (2**64 - 1), at
    raise ValueError("a number without end")


def _message(value: int | memoryview) -> memoryview:
    """The value of a field that must be a message."""
    if isinstance(value, int):
        raise ValueError("a number, expected a message")
    return value


def _text(value: int | memoryview) -> str:
    return bytes(_message(value)).decode(errors="replace")
