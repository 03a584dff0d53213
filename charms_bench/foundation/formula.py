"""Formulas in a scenario: numbers, names of parameters, `+ - * /` and parentheses."""

import ast
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from charms_bench.errors import suggestion
from charms_bench.foundation.fields import Finite, Line

Formula = Finite | Annotated[Line, Field(min_length=1, max_length=100)]
"""A number, or a text such as `ego_speed - slower`."""
_OPERATIONS: dict[type, Any] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
}


def evaluate(formula: float | str, values: Mapping[str, NDArray[np.float64]]) -> Any:
    """The value of a formula, given those of the parameters; raises a `ValueError`."""
    if not isinstance(formula, str):
        return float(formula)
    try:
        tree = ast.parse(formula.strip(), mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise ValueError(_expected(formula)) from error
    with np.errstate(all="ignore"):
        return _value(tree, formula, values)


def _value(node: ast.expr, formula: str, values: Mapping[str, NDArray[np.float64]]) -> Any:
    if isinstance(node, ast.Name):
        if node.id not in values:
            raise ValueError(f"no parameter named '{node.id}'. {suggestion(node.id, values)}")
        return values[node.id]
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        if isinstance(node.value, bool):  # an int for Python
            raise ValueError(_expected(formula))
        return np.float64(node.value)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
        sides = (_value(side, formula, values) for side in (node.left, node.right))
        return _OPERATIONS[type(node.op)](*sides)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -_value(node.operand, formula, values)
    raise ValueError(_expected(formula))


def _expected(formula: str) -> str:
    return f"'{formula}' is not a formula; expected numbers, parameters and + - * / ( )"
