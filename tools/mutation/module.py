"""The syntax tree of a module, and what of it may be changed."""

import ast
import re
from collections.abc import Iterator
from itertools import accumulate

DECORATORS = {"compiled", "inlined", "woven", "compiled_of_scenes"}
DECORATORS |= {"register_jitable", "_of_roads"}
UNTOUCHED = {"annotation", "returns", "decorator_list", "bases", "type_params"}
DESCRIBING = {"__repr__", "__str__", "_repr_html_", "title"}
"""Functions whose results are only read."""
Edit = tuple[tuple[int, int], str]
"""The span of bytes that is replaced, and its replacement."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


class Module:
    """The syntax tree of a module, and the text of its nodes."""

    def __init__(self, code: bytes) -> None:
        self.code = code
        self.lines = [0, *accumulate(map(len, code.splitlines(keepends=True)))]
        self.tree = ast.parse(code)
        self.parents: dict[ast.AST, ast.AST] = {}
        self.nodes = list(self._mutable(self.tree))
        kernels = [node for node in self.nodes if _is_compiled(node)]
        self._names = {name for kernel in kernels for name in names(kernel, ast.Load)}

    def _mutable(self, node: ast.AST) -> Iterator[ast.AST]:
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr):
            return
        if isinstance(node, Function) and node.name in DESCRIBING:
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        yield node
        for name, value in ast.iter_fields(node):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and name not in UNTOUCHED:
                    self.parents[child] = node
                    yield from self._mutable(child)

    def span(self, first: ast.AST, last: ast.AST | None = None) -> tuple[int, int]:
        """The bytes from a node to the same or another one."""
        last = last or first
        start = self.lines[first.lineno - 1] + first.col_offset  # type: ignore[attr-defined]
        return start, self.lines[last.end_lineno - 1] + last.end_col_offset  # type: ignore

    def text(self, node: ast.AST) -> str:
        start, end = self.span(node)
        return self.code[start:end].decode()

    def above(self, node: ast.AST) -> Iterator[ast.AST]:
        """The nodes around a node, from the inside to the outside."""
        while node in self.parents:
            node = self.parents[node]
            yield node

    def function(self, node: ast.AST) -> Function | None:
        """The outermost function that a node is part of."""
        around = [node, *self.above(node)]
        return next((each for each in reversed(around) if isinstance(each, Function)), None)

    def is_kernel(self, node: ast.AST) -> bool:
        """Whether a node is part of compiled code, or of a constant that compiled code reads."""
        function = self.function(node)
        if function is not None:
            return _is_compiled(function)
        assigned = (up for up in self.above(node) if isinstance(up, ast.Assign))
        return any(names(each, ast.Store) & self._names for each in assigned)

    def replaced(
        self, left: ast.AST, right: ast.AST, pattern: str, tokens: dict[str, str]
    ) -> Iterator[Edit]:
        """Exchanges the operator between two operands."""
        start, end = self.span(left)[1], self.span(right)[0]
        between = self.code[start:end].decode()
        found = re.search(pattern, between)
        if found and "#" not in between and (after := tokens.get(found[0])):
            yield (start + found.start(), start + found.end()), after


def _is_compiled(node: ast.AST) -> bool:
    return isinstance(node, Function) and any(
        getattr(each, "id", "") in DECORATORS for each in node.decorator_list
    )


def names(node: ast.AST, context: type[ast.expr_context]) -> set[str]:
    """The names that code reads or assigns."""
    found = (each for each in ast.walk(node) if isinstance(each, ast.Name))
    return {each.id for each in found if isinstance(each.ctx, context)}


def name_of(call: ast.AST) -> str:
    """The name of the function that is called, without its module or object."""
    function = getattr(call, "func", None)
    return getattr(function, "id", "") or getattr(function, "attr", "")
