"""The faults that are put into code, each a function from a node of a module to its edits.

Rules that avoid most changes that no test can notice: no `<` for `<=` where a side is a fraction or
a random number, since the sides are never equal; no number below 0.001, which allows for rounding;
no loop reversed unless it draws, ends early, or keeps what it finds.
"""

import ast
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from mutation import module as tree
from mutation.module import Edit, Function, Module, name_of, names

DRAWS = re.compile(r"\b(draw\w*|random|uniform|normal|integers|choice|permutation|word)\(")
SHAPES = {"axis", "decimals", "ndmin", "dtype"}
"""Arguments in which another number is an error at once."""
SYMMETRIC = {"min", "max", "minimum", "maximum", "isinstance", "range", "zip", "hypot", "getattr"}
_COMPARISON = r"<=|>=|==|!=|<|>|\bnot in\b|\bin\b|\bis not\b|\bis\b"
_OPPOSITE = {"<": ">", "<=": ">=", "==": "!=", "in": "not in", "is": "is not"}
_OPPOSITE |= {after: before for before, after in _OPPOSITE.items()}
_STRICT = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
_SIGN = {"+": "-", "-": "+", "*": "/", "/": "*", "+=": "-=", "-=": "+=", "*=": "/=", "/=": "*="}
_EXTREMES = {"min": "max", "minimum": "maximum", "argmin": "argmax", "fmin": "fmax"}
_EXTREMES |= {after: before for before, after in _EXTREMES.items()}


def _operands(node: ast.AST) -> list[ast.AST]:
    return [node.left, *node.comparators] if isinstance(node, ast.Compare) else []


def tie_rule(module: Module, node: ast.AST) -> Iterator[Edit]:
    """A strict comparison made lax, or a lax one strict."""
    for left, right in pairwise(_operands(node)):
        texts = module.text(left), module.text(right)
        if not any(re.search(r"\d\.\d*[1-9]|\de-", text) or DRAWS.search(text) for text in texts):
            yield from module.replaced(left, right, _COMPARISON, _STRICT)


def comparison(module: Module, node: ast.AST) -> Iterator[Edit]:
    """A comparison turned round."""
    for left, right in pairwise(_operands(node)):
        yield from module.replaced(left, right, _COMPARISON, _OPPOSITE)


def clause(module: Module, node: ast.AST) -> Iterator[Edit]:
    """One of several conditions dropped, such as what decides ties."""
    if isinstance(node, ast.BoolOp):
        word = " and " if isinstance(node.op, ast.And) else " or "
        texts = [f"({module.text(value)})" for value in node.values]
        for i in range(len(texts)):
            yield module.span(node), word.join(texts[:i] + texts[i + 1 :])


def connective(module: Module, node: ast.AST) -> Iterator[Edit]:
    """`and` and `or` exchanged, or `&` and `|` of conditions."""
    if isinstance(node, ast.BoolOp):
        for left, right in pairwise(node.values):
            yield from module.replaced(left, right, "and|or", {"and": "or", "or": "and"})
    if isinstance(node, ast.BinOp):
        conditions = ast.Compare | ast.BoolOp | ast.UnaryOp
        if isinstance(node.left, conditions) or isinstance(node.right, conditions):
            yield from module.replaced(node.left, node.right, r"[&|]", {"&": "|", "|": "&"})


def condition(module: Module, node: ast.AST) -> Iterator[Edit]:
    """A condition negated, except of those that only report errors."""
    only_reports = any(isinstance(each, ast.Raise) for each in tree.body_of(node))
    if isinstance(node, ast.If | ast.IfExp) and not only_reports:
        yield module.span(node.test), f"(not ({module.text(node.test)}))"


def sign(module: Module, node: ast.AST) -> Iterator[Edit]:
    """+ and -, or * and /, exchanged, or a minus dropped."""
    if isinstance(node, ast.BinOp):
        sides = map(tree.is_text, (node.left, node.right))
        if not (any(sides) or tree.is_index(module, node)):
            yield from module.replaced(node.left, node.right, r"[-+*/%@&|<>^]+", _SIGN)
    elif isinstance(node, ast.AugAssign) and not tree.is_text(node.value):
        yield from module.replaced(node.target, node.value, r"\S+", _SIGN)
    elif isinstance(getattr(node, "op", None), ast.USub) and not tree.is_index(module, node):
        yield module.span(node), f"({module.text(node.operand)})"


def number(module: Module, node: ast.AST) -> Iterator[Edit]:
    """A number increased, by 1 or a tenth."""
    value, parent = getattr(node, "value", None), module.parents.get(node)
    if not isinstance(node, ast.Constant) or tree.is_index(module, node):
        return
    if isinstance(parent, ast.keyword) and parent.arg in SHAPES:
        return
    if type(value) is int:
        yield module.span(node), str(value + 1)
    elif type(value) is float and (value == 0 or value >= 1e-3):
        yield module.span(node), repr(float(f"{value * 1.1 or 0.1:.6g}"))


def truth(module: Module, node: ast.AST) -> Iterator[Edit]:
    """True and False exchanged, except as a keyword's value."""
    is_value = isinstance(module.parents.get(node), ast.Assign | ast.Return | ast.IfExp | ast.Call)
    if is_value and isinstance(node, ast.Constant) and type(node.value) is bool:
        yield module.span(node), str(not node.value)


def exchange(module: Module, node: ast.AST) -> Iterator[Edit]:
    """Two neighbouring draws exchanged, or two neighbouring arguments of one kind."""
    simple = ast.Assign | ast.AugAssign | ast.Expr
    for first, second in pairwise(tree.body_of(node)):
        texts = module.text(first), module.text(second)
        is_drawn = all(isinstance(each, simple) for each in (first, second)) and all(
            map(DRAWS.search, texts)
        )
        if is_drawn and not names(first, ast.Store) & names(second, ast.Load):
            yield module.span(first, second), module.between(first, second).join(texts[::-1])
    if isinstance(node, ast.Call) and name_of(node) not in SYMMETRIC:
        for i, (one, other) in enumerate(pairwise(node.args)):
            texts = module.text(one), module.text(other)
            # The first name is mostly the scene, the road or the generator; plurals are arrays.
            is_apart = isinstance(one, ast.Name) and (
                i == 0 or texts[0].endswith("s") != texts[1].endswith("s")
            )
            is_alike = type(one) is type(other) and texts[0] != texts[1]
            if is_alike and not is_apart | tree.is_text(one):
                between = module.between(one, other)
                if "(" not in between and ")" not in between:
                    yield module.span(one, other), between.join(texts[::-1])


def order(module: Module, node: ast.AST) -> Iterator[Edit]:
    """A loop that starts one later, or runs backwards where that matters."""
    if not isinstance(node, ast.For) or name_of(node.iter) != "range":
        return
    bounds = [module.text(each) for each in node.iter.args]  # type: ignore[attr-defined]
    if len(bounds) > 2:
        return
    start, end = (["0"] * 2 + bounds)[-2:] if len(bounds) == 2 else ["0", *bounds]
    shifted = "1" if start == "0" else f"{start} + 1"
    yield module.span(node.iter), f"range({shifted}, {end})"
    draws = DRAWS.search(module.text(node))
    matters = draws or tree.ends_early(module, node) or tree.keeps_state(module, node)
    if getattr(node.target, "id", "_") != "_" and matters:
        yield module.span(node.iter), f"range({end} - 1, {start} - 1, -1)"


def stale(module: Module, node: ast.AST) -> Iterator[Edit]:
    """An assignment dropped, so that the value from before stays."""
    function = module.function(node)
    if function is None or getattr(function, "name", "") == "__init__":
        return
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
        if node.targets[0].id in tree.known_before(function, node.lineno):
            yield module.span(node), "pass"
    elif isinstance(node, ast.AugAssign) or (
        isinstance(node, ast.Assign) and not isinstance(node.targets[0], ast.Tuple)
    ):
        yield module.span(node), "pass"


def extreme(module: Module, node: ast.AST) -> Iterator[Edit]:
    """Minimum and maximum exchanged."""
    if after := _EXTREMES.get(name_of(node)):
        _, end = module.span(node.func)  # type: ignore[attr-defined]
        yield (end - len(name_of(node)), end), after


def way_out(module: Module, node: ast.AST) -> Iterator[Edit]:
    """An early return, `continue` or `break` dropped."""
    branch = module.parents.get(node)
    if not isinstance(branch, ast.If) or branch.orelse or node not in branch.body:
        return
    around = module.parents[branch]
    is_last = isinstance(around, Function) and around.body[-1] is branch
    is_endless = any(isinstance(up, ast.While) for up in module.above(node))
    can_go_on = isinstance(node, ast.Break | ast.Return) and not is_last | is_endless
    if isinstance(node, ast.Continue) or can_go_on:
        yield module.span(node), "pass"


def index(module: Module, node: ast.AST) -> Iterator[Edit]:
    """An index off by one."""
    if not isinstance(node, ast.Constant | ast.Name) or not tree.is_index(module, node):
        return
    parent = module.parents[node]
    if isinstance(node, ast.Constant) and type(node.value) is int and name_of(parent) != "range":
        yield module.span(node), str(node.value - 1 if node.value > 0 else 1)
    elif isinstance(node, ast.Name) and isinstance(parent, ast.Subscript | ast.Tuple):
        loops = (up for up in module.above(node) if isinstance(up, ast.For))
        ranges = (up for up in loops if name_of(up.iter) == "range")
        if any(getattr(up.target, "id", None) == node.id for up in ranges):
            yield module.span(node), f"{node.id} - 1"


OPERATORS: Sequence[Callable[[Module, ast.AST], Iterator[Edit]]] = (
    *(tie_rule, comparison, clause, connective, condition, sign, number, truth),
    *(exchange, order, stale, extreme, way_out, index),
)
