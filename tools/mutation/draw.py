"""All mutations of the source code, and a seeded draw among them."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from mutation.module import Module
from mutation.operators import OPERATORS, exchange, number, sign

LOOKS = re.compile(
    r"report/(figures|html)/|world/(palette|picture)|episodes/animation|/\w*rendering"
)
"""Modules whose numbers mostly change how something looks, which no test can judge."""


class Mutation(NamedTuple):
    """One change of one module."""

    path: str
    line: int
    function: str
    """Empty outside functions."""
    is_kernel: bool
    operator: str
    start: int
    end: int
    before: str
    after: str

    @property
    def key(self) -> str:
        """What stands in `equivalent.txt`."""
        change = f"{self.path} {self.function}: {self.before} -> {self.after}"
        return " ".join(change.split())

    def applied(self, code: bytes) -> bytes:
        """The module's code with the fault."""
        return code[: self.start] + self.after.encode() + code[self.end :]


def mutations(path: str, code: bytes) -> Iterator[Mutation]:
    """All mutations of a module; outside functions, only numbers change."""
    module = Module(code)
    for node in module.nodes:
        function = module.function(node)
        for operator in OPERATORS if function else [number]:
            if operator in (number, exchange, sign) and LOOKS.search(path):
                continue
            for (start, end), after in operator(module, node):
                yield Mutation(
                    path,
                    code[:start].count(b"\n") + 1,
                    getattr(function, "name", ""),
                    module.is_kernel(node),
                    operator.__name__,
                    start,
                    end,
                    code[start:end].decode(),
                    after,
                )


def drawn(found: Sequence[Mutation], seed: int, count: int) -> list[Mutation]:
    """Draws `count` mutations, as equally as possible from all operators, then from all modules.

    Each has a random place of its own, so that a change of other code moves few others.
    """

    def place(mutation: Mutation) -> tuple[bytes, int]:
        return sha256(f"{seed} {mutation.key}".encode()).digest(), mutation.start

    pool = sorted(found, key=place)
    operators: Counter[str] = Counter()
    modules: Counter[str] = Counter()
    chosen: list[Mutation] = []
    while pool and len(chosen) < count:
        best = min(pool, key=lambda each: (operators[each.operator], modules[each.path]))
        pool.remove(best)
        chosen.append(best)
        operators[best.operator] += 1
        modules[best.path] += 1
    return chosen


def source_mutations(root: Path, folders: Sequence[str]) -> list[Mutation]:
    """All mutations of the modules in some folders of a checkout."""
    paths = sorted({path for each in folders for path in (root / each).rglob("*.py")})
    return [
        mutation
        for path in paths
        for mutation in mutations(path.relative_to(root).as_posix(), path.read_bytes())
    ]
