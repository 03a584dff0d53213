"""Finds out whether a network divides integers.

The smallest integer divided by -1 ends the process (SIGFPE), and both may come from an observation
that nobody has tried. Floating-point numbers can be divided without harm. The first input of each
division has to be floating-point for certain: types follow from the inputs of the graph, its
constants and its operators, as ONNX declares them.
"""

from collections.abc import Sequence
from typing import NamedTuple

from charms_bench.plugins.protobuf import Fields, Value, message_of, text_of

_GRAPH = 7  # of a model
_NODE, _INITIALIZER, _INPUT = 1, 5, 11  # of a graph
_TAKEN, _GIVEN, _OPERATOR, _ATTRIBUTE = 1, 2, 4, 5  # of a node
_NAME, _FLOAT, _INTEGER, _TENSOR, _FLOATS, _INTEGERS = 1, 2, 3, 5, 7, 8  # of an attribute
_DATA_TYPE, _TENSOR_NAME = 2, 8  # of a tensor
_INPUT_NAME, _INPUT_TYPE, _TENSOR_TYPE, _ELEMENT_TYPE = 1, 2, 1, 1  # of an input and its type
_FLOATING = {1, 10, 11, 16}
"""The types float32, float16, float64 and bfloat16."""
_NEVER_FLOATING = {"And", "ArgMax", "ArgMin", "Equal", "Greater", "GreaterOrEqual", "Less"}
_NEVER_FLOATING |= {"LessOrEqual", "Not", "Or", "Shape", "Size", "Xor"}
_TYPED_BY = {"Where": 1, "OneHot": 2}
"""The operators whose result has the type of another input than the first."""
_ALIKE = {"Split", "LSTM", "GRU", "RNN"}
"""The operators all of whose results have the same type."""
_CONSTANTS = {"Constant", "ConstantOfShape"}
_DIVISIONS = {"Div", "Mod"}


class _Node(NamedTuple):
    operator: str
    taken: Sequence[str]
    given: Sequence[str]
    types: set[Value]
    """The types that its attributes name, or those of the constants in them."""


def divides_integers(model: memoryview) -> bool:
    """Returns whether a division may be one of integers.

    Raises:
        ValueError, IndexError: It is not a model.
    """
    fields = Fields()
    floating: dict[str, bool] = {"": False}
    nodes = []
    for number, graph in fields.of(model):
        for kind, value in fields.of(message_of(graph)) if number == _GRAPH else ():
            if kind == _NODE:
                nodes.append(_node(message_of(value), fields))
            elif kind in (_INITIALIZER, _INPUT):
                is_input = kind == _INPUT
                names, types = (_input if is_input else _tensor)(message_of(value), fields)
                for name in names:
                    floating[name] = _all_floating(types) and floating.get(name, True)
    for node in nodes:
        place = _TYPED_BY.get(node.operator, 0)
        source = node.taken[place] if place < len(node.taken) else ""
        is_floating = floating.get(source, False)
        if node.operator in _DIVISIONS and not is_floating:
            return True
        if node.operator in _CONSTANTS or node.operator == "Cast":
            is_default = node.operator == "ConstantOfShape" and not node.types
            is_floating = is_default or _all_floating(node.types)
        elif node.operator in _NEVER_FLOATING:
            is_floating = False
        for index, name in enumerate(node.given):
            is_alike = index == 0 or node.operator in _ALIKE
            floating[name] = is_floating and is_alike and floating.get(name, True)
    return False


def _all_floating(types: set[Value]) -> bool:
    return bool(types) and types <= _FLOATING


def _node(node: memoryview, fields: Fields) -> _Node:
    operator, types = "", set[Value]()
    taken, given = [], []
    for number, value in fields.of(node):
        if number == _OPERATOR:
            operator = text_of(value)
        elif number == _TAKEN:
            taken.append(text_of(value))
        elif number == _GIVEN:
            given.append(text_of(value))
        elif number == _ATTRIBUTE:
            types |= _types_of_attribute(message_of(value), fields)
    return _Node(operator, taken, given, types)


def _types_of_attribute(attribute: memoryview, fields: Fields) -> set[Value]:
    parts = list(fields.of(attribute))
    names = {text_of(value) for number, value in parts if number == _NAME}
    if names == {"to"}:
        return {value for number, value in parts if number == _INTEGER}
    types = set[Value]()
    for number, value in parts:
        if number == _TENSOR:
            types |= _tensor(message_of(value), fields)[1]
        elif number in (_FLOAT, _FLOATS):
            types.add(1)
        elif number in (_INTEGER, _INTEGERS):
            types.add(7)
    return types if any(name.startswith("value") for name in names) else set()


def _tensor(tensor: memoryview, fields: Fields) -> tuple[set[str], set[Value]]:
    parts = list(fields.of(tensor))
    names = {text_of(value) for number, value in parts if number == _TENSOR_NAME}
    return names, {value for number, value in parts if number == _DATA_TYPE}


def _input(port: memoryview, fields: Fields) -> tuple[set[str], set[Value]]:
    names, types = set(), set[Value]()
    for number, value in fields.of(port):
        if number == _INPUT_NAME:
            names.add(text_of(value))
        elif number == _INPUT_TYPE:
            for kind, tensor in fields.of(message_of(value)):
                inner = fields.of(message_of(tensor)) if kind == _TENSOR_TYPE else ()
                types |= {element for each, element in inner if each == _ELEMENT_TYPE}
    return names, types
