"""Checks what an ONNX file contains before onnxruntime loads it.

Only the fields that matter here are read, by their numbers in `onnx.proto`. What a network costs,
and whether it ends its process, a worker finds out; see `onnx_session`.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from charms_bench.plugins.protobuf import FIELDS_LIMIT, Reader, TooManyFieldsError, text_of

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

_TENSOR = {2: "type", 13: "external", 14: "location"}
_ATTRIBUTE = {
    1: "name", 3: "integer", 5: ("tensor", _TENSOR), 6: "graph", 10: ("tensor", _TENSOR),
    11: "graph", 22: "sparse", 23: "sparse",
}  # fmt: skip
_NODE = {4: "operator", 5: ("attribute", _ATTRIBUTE), 7: "domain"}
_GRAPH = {1: ("node", _NODE), 5: ("initializer", _TENSOR), 15: "sparse"}
_MODEL = {7: ("graph", _GRAPH), 14: ("metadata", {1: "key"}), 25: "function"}
_STRING = 8
"""The type of texts."""

Message = Mapping[str, Sequence[Any]]


def problem_of(data: bytes) -> str:
    """Why a file must not be loaded; empty if the file passes all checks."""
    try:
        return next(_problems(Reader().read(memoryview(data), _MODEL)), "")
    except TooManyFieldsError:
        return f"has more than {FIELDS_LIMIT:,} fields; a policy is far smaller"
    except (IndexError, ValueError):
        return "is not an ONNX file, or is damaged"


def _problems(model: Message) -> Iterator[str]:
    # Readers merge a field that is given several times.
    names = ("node", "initializer", "sparse")
    graph = {name: [each for part in model["graph"] for each in part[name]] for name in names}
    for node in graph["node"][:NODES_LIMIT]:
        yield from _problems_of_node(node)
    if len(graph["node"]) > NODES_LIMIT:
        yield f"has more than {NODES_LIMIT:,} nodes; a policy is far smaller"
    for tensor in graph["initializer"]:
        yield from _problems_of_tensor(tensor)
    if graph["sparse"]:
        yield "has sparse tensors; save it with dense ones"
    if model["function"]:
        yield "has functions; save it with all functions inlined"
    keys = [text_of(key) for entry in model["metadata"] for key in entry["key"]]
    if doubled := sorted({key for key in keys if keys.count(key) > 1}):
        yield f"metadata: has the key '{doubled[0][:80]}' {keys.count(doubled[0])} times"


def _problems_of_node(node: Message) -> Iterator[str]:
    domains = [text_of(value) for value in node["domain"]]
    for name in map(text_of, node["operator"]):
        if name not in OPERATORS or any(domain not in ("", "ai.onnx") for domain in domains):
            full = ".".join(filter(None, (*domains, name)))
            yield f"has the operator '{full[:80]}'; a policy may only have ONNX's arithmetic"
    for attribute in node["attribute"]:
        names = {*map(text_of, attribute["name"])}
        is_cast = names == {"to"} and _STRING in attribute["integer"]
        if is_cast or names & {"value_string", "value_strings"}:
            yield "has texts among its tensors"
        for tensor in attribute["tensor"]:
            yield from _problems_of_tensor(tensor)
        if attribute["graph"]:
            yield "has graphs within its graph"
        if attribute["sparse"]:
            yield "has sparse tensors; save it with dense ones"


def _problems_of_tensor(tensor: Message) -> Iterator[str]:
    if tensor["external"] or any(tensor["location"]):
        yield (
            "keeps tensors in other files; save it as a single file, in PyTorch with "
            "torch.onnx.export(..., external_data=False)"
        )
    if _STRING in tensor["type"]:
        yield "has texts among its tensors"
