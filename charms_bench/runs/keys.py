"""Code by its hash, so that rows of other code are never taken for those of this."""

from collections.abc import Iterable, Iterator
from functools import cache
from hashlib import sha256
from importlib.machinery import BYTECODE_SUFFIXES, all_suffixes
from importlib.util import find_spec
from pathlib import Path

ROW_MODULES = ("engine", "plugins", "world")
"""The modules of this package that decide what is recorded of an episode."""
_SUFFIXES = tuple(set(all_suffixes()) - set(BYTECODE_SUFFIXES))


@cache
def harness_sha256() -> str:
    """Hash of `ROW_MODULES`."""
    here = Path(__file__).parent.parent
    return _sha256(path for name in ROW_MODULES for path in (here / f"{name}.py", here / name))


@cache
def code_sha256(module: str) -> str:
    """Hash of all code of the package that a module stands in, compiled extensions included."""
    spec = find_spec(module.partition(".")[0])
    if spec is None:
        return ""
    return _sha256(map(Path, spec.submodule_search_locations or [str(spec.origin)]))


def _sha256(roots: Iterable[Path]) -> str:
    digest = sha256()
    for root in roots:
        for path in _code(root):
            digest.update(path.relative_to(root.parent).as_posix().encode() + b"\0")
            digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()


def _code(root: Path) -> Iterator[Path]:
    """The files of code that a folder or a file is."""
    if root.is_file():
        yield root
    yield from sorted(path for path in root.rglob("*") if path.name.endswith(_SUFFIXES))
