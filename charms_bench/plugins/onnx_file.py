"""Checks what an ONNX file contains before onnxruntime loads it.

Only the fields that matter here are read, by their numbers in `onnx.proto`.

Integers must not be divided: the smallest integer divided by -1 ends the process (SIGFPE), and both
may come from an observation that nobody has tried. Floating-point numbers can be divided without
harm. The first input of each division has to be floating-point for certain: types follow from the
inputs of the graph, its constants and its operators, as ONNX declares them. Or else, the second
input has to be a constant without a 0 or a -1, as in the attention of PyTorch.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from charms_bench.plugins.protobuf import FIELDS_LIMIT, Reader, TooManyFieldsError, text_of, varint

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

_TENSOR = {
    2: "type", 5: "integers", 7: "integers", 8: "name", 9: "raw", 11: "integers",
    13: "external", 14: "location",
}  # fmt: skip
_ATTRIBUTE = {
    1: "name", 2: "float", 3: "integer", 5: ("tensor", _TENSOR), 6: "graph", 7: "floats",
    8: "integers", 10: ("tensors", _TENSOR), 11: "graph", 22: "sparse", 23: "sparse",
}  # fmt: skip
_NODE = {1: "taken", 2: "given", 4: "operator", 5: ("attribute", _ATTRIBUTE), 7: "domain"}
_INPUT = {1: "name", 2: ("type", {1: ("tensor", {1: "element"})})}
_GRAPH = {1: ("node", _NODE), 5: ("initializer", _TENSOR), 11: ("input", _INPUT), 15: "sparse"}
_MODEL = {7: ("graph", _GRAPH), 14: ("metadata", {1: "key"}), 25: "function"}
_STRING = 8
_FLOATING = {1, 10, 11, 16}
"""The types float32, float16, float64 and bfloat16."""
_BYTES = {2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 8, 12: 4, 13: 8}
"""The types of integers, and how many bytes each takes."""
_NEVER_FLOATING = {"And", "ArgMax", "ArgMin", "Equal", "Greater", "GreaterOrEqual", "Less"}
_NEVER_FLOATING |= {"LessOrEqual", "Not", "Or", "Shape", "Size", "Xor"}
_TYPED_BY = {"Where": 1, "OneHot": 2}
"""The operators whose result has the type of another input than the first."""
_ALIKE = {"Split", "LSTM", "GRU", "RNN"}
"""The operators all of whose results have the same type."""

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
    names = ("node", "initializer", "input", "sparse")
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
    if _divides_integers(graph):
        yield (
            "divides integers (Div or Mod), which can end the process; divide floats, or by a "
            "constant other than 0 and -1"
        )


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
        for tensor in (*attribute["tensor"], *attribute["tensors"]):
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


def _divides_integers(graph: Message) -> bool:
    """Whether a division may be one of integers by 0 or -1."""
    safe = _safe_divisors(graph)
    floating: dict[str, bool] = {"": False}
    typed = [(tensor["name"], tensor["type"]) for tensor in graph["initializer"]]
    for port in graph["input"]:
        tensors = (tensor for kind in port["type"] for tensor in kind["tensor"])
        typed.append((port["name"], [each for tensor in tensors for each in tensor["element"]]))
    for names, types in typed:
        for name in map(text_of, names):
            floating[name] = _all_floating(types) and floating.get(name, True)
    for node in graph["node"]:
        operator = text_of(node["operator"][-1]) if node["operator"] else ""
        taken, place = node["taken"], _TYPED_BY.get(operator, 0)
        source = text_of(taken[place]) if place < len(taken) else ""
        is_floating = floating.get(source, False)
        divisor = text_of(taken[1]) if len(taken) > 1 else ""
        if operator in ("Div", "Mod") and not is_floating and divisor not in safe:
            return True
        if operator in ("Constant", "ConstantOfShape", "Cast"):
            types = [each for attribute in node["attribute"] for each in _types_in(attribute)]
            is_floating = _all_floating(types) or (operator == "ConstantOfShape" and not types)
        elif operator in _NEVER_FLOATING:
            is_floating = False
        for index, name in enumerate(map(text_of, node["given"])):
            is_alike = index == 0 or operator in _ALIKE
            floating[name] = is_floating and is_alike and floating.get(name, True)
    return False


def _safe_divisors(graph: Message) -> set[str]:
    """The names of the constants that are integers other than 0 and -1."""
    found: dict[str, bool] = {}
    named = [(tensor["name"], _is_safe(tensor)) for tensor in graph["initializer"]]
    named += [(port["name"], False) for port in graph["input"]]  # may replace an initializer
    for node in graph["node"]:
        tensors = [tensor for each in node["attribute"] for tensor in each["tensor"]]
        is_constant = [*map(text_of, node["operator"])] == ["Constant"] and len(tensors) == 1
        named.append((node["given"], is_constant and _is_safe(tensors[0])))
    for names, is_safe in named:
        for name in map(text_of, names):
            found[name] = is_safe and name not in found
    return {name for name, is_safe in found.items() if is_safe}


def _is_safe(tensor: Message) -> bool:
    """Whether a tensor has integers, in one of the ways to give them, and none is 0 or -1."""
    ways, kind = [*tensor["raw"], *tensor["integers"]], tensor["type"][-1:]
    if len(ways) != 1 or not kind or kind[0] not in _BYTES or isinstance(ways[0], int):
        return False
    data, size = memoryview(ways[0]), _BYTES[kind[0]]
    values, at = [], 0
    while at < len(data):
        if tensor["raw"]:
            value, at = int.from_bytes(data[at : at + size], "little"), at + size
        else:
            value, at = varint(data, at)
        values.append(value % 2 ** (8 * size))  # as they are stored
    return bool(values) and not {0, 2 ** (8 * size) - 1} & set(values)


def _all_floating(types: Sequence[Any]) -> bool:
    return bool(types) and _FLOATING.issuperset(types)


def _types_in(attribute: Message) -> list[Any]:
    """The types that an attribute names, or those of the constants in it."""
    names = {text_of(name) for name in attribute["name"]}
    if names == {"to"}:
        return list(attribute["integer"])
    if not any(name.startswith("value") for name in names):
        return []
    types = [each for tensor in attribute["tensor"] for each in tensor["type"]]
    types += [1] * bool(attribute["float"] or attribute["floats"])
    return types + [7] * bool(attribute["integer"] or attribute["integers"])
