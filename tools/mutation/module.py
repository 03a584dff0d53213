"""The syntax tree of a module, and what of it may be changed."""

import ast
import re
from collections.abc import Iterator
from itertools import accumulate, pairwise

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

    def between(self, first: ast.AST, second: ast.AST) -> str:
        """The text after a node and before another one."""
        return self.code[self.span(first)[1] : self.span(second)[0]].decode()

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
        start, between = self.span(left)[1], self.between(left, right)
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


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def is_index(module: Module, node: ast.AST) -> bool:
    """Whether a number is part of an index or of the bounds of a range."""
    inside = [node, *module.above(node)]
    return any(
        (isinstance(up, ast.Subscript) and up.slice is child) or name_of(up) == "range"
        for child, up in pairwise(inside)
    )


def body_of(node: ast.AST) -> list[ast.stmt]:
    body = getattr(node, "body", [])
    return body if isinstance(body, list) else []


def ends_early(module: Module, loop: ast.For) -> bool:
    for each in ast.walk(loop):
        around = (up for up in module.above(each) if isinstance(up, ast.For | ast.While))
        is_own = next(around, None) is loop
        if isinstance(each, ast.Return) or (isinstance(each, ast.Break) and is_own):
            return True
    return False


def keeps_state(module: Module, loop: ast.For) -> bool:
    """Whether a loop changes, on a condition, what was there before it."""
    assigned = {
        name
        for branch in ast.walk(loop)
        if isinstance(branch, ast.If)
        for name in names(branch, ast.Store)
    }
    return bool(assigned & known_before(module.function(loop), loop.lineno))


def known_before(function: ast.AST | None, line: int) -> set[str]:
    """The names that a function assigns before a line, and its arguments."""
    known: set[str] = set()
    for each in ast.walk(function) if function else ():
        if isinstance(each, ast.arg):
            known.add(each.arg)
        elif isinstance(each, ast.Assign) and (each.end_lineno or 0) < line:
            known |= names(each, ast.Store)
    return known
