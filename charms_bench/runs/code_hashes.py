"""Hashes of the code that decides rows, so that rows from different code are never mixed.

The rows of a shard depend on the module that workers run (`ENTRY`) and on every module that it
imports, directly or not. These modules are found in the sources, so no list has to be kept. The
engine of highway-env's roads (`ROADS`) decides only the rows on these; all of its modules do.
"""

import ast
import json
import re
import subprocess
from collections.abc import Iterator, Mapping
from functools import cache
from hashlib import sha1, sha256
from importlib.machinery import BYTECODE_SUFFIXES, all_suffixes
from importlib.metadata import PackageNotFoundError, distribution, version
from importlib.util import find_spec
from pathlib import Path

ENTRY = "charms_bench.runs.shard"
ROADS = "charms_bench.roads"
SOURCES = Path(__file__).parents[2]
"""The folder that holds this package."""
_LIBRARIES = ("highway-env", "numba", "numpy", "onnxruntime", "polars")
_FOR_TYPE_CHECKERS = re.compile(r"^( *)if TYPE_CHECKING:(?:\n+\1 +.*)+", re.MULTILINE)
_IMPORT = re.compile(
    r"^ *((?:from|import) +(?:charms_bench|\.)[^(\n]*(?:\([^)]*\))?)", re.MULTILINE
)
"""A statement that imports from this package, on one line or in parentheses."""
_SUFFIXES = tuple(set(all_suffixes()) - set(BYTECODE_SUFFIXES))


@cache
def library_versions() -> dict[str, str]:
    """Returns the versions of the libraries that decide what a row holds or how it is written.

    highway-env decides only the rows of the engine of that name, and need not be installed.
    """
    found = {}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            if name != "highway-env":
                raise
    return found


def row_modules(
    sources: Path = SOURCES, entry: str = ENTRY, without: str | None = None
) -> dict[str, Path]:
    """Returns the modules of this package that decide rows, by name, with their files.

    They are `entry` and everything that it imports, inside functions too, except what only type
    checkers import, and the package `without`. Importing a module runs its parent packages, so
    these are included.
    """
    found: dict[str, Path] = {}
    waiting, seen = [entry], {entry}
    while waiting:
        name = waiting.pop()
        path = sources.joinpath(*name.split("."))
        source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if without and f"{name}.".startswith(f"{without}."):
            continue
        if source.is_file():  # else it is a name inside a module
            found[name] = source
            imports = {*imported_modules(source.read_text(encoding="utf-8"))}
            if name == ROADS:  # it imports its environments by their names
                imports |= {f"{ROADS}.{each.stem}" for each in path.glob("[!_]*.py")}
            named = {name.rpartition(".")[0] or name, *imports} - seen
            waiting += named
            seen |= named
    return dict(sorted(found.items()))


def imported_modules(source: str) -> Iterator[str]:
    """Yields the dotted names in this package that a module imports, wherever it does.

    Only its import statements are parsed, because every worker does this when it starts.
    """
    found = _IMPORT.findall(_FOR_TYPE_CHECKERS.sub("", source))
    for node in ast.parse("\n".join(found)).body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                raise ValueError("a relative import, which is not followed")
            yield from (str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names))


@cache
def harness_sha256(sources: Path = SOURCES, entry: str = ENTRY, without: str | None = None) -> str:
    """Returns the hash of `row_modules`."""
    return _sha256(row_modules(sources, entry, without))


@cache
def code_sha256(module: str) -> str:
    """Returns the hash of all code of a module's package, compiled extensions included."""
    spec = find_spec(module.partition(".")[0])
    if spec is None:
        return ""
    files: dict[str, Path] = {}
    for root in map(Path, spec.submodule_search_locations or [str(spec.origin)]):
        code = [root] if root.is_file() else root.rglob("*")
        found = (path for path in code if path.name.endswith(_SUFFIXES))
        files |= {path.relative_to(root.parent).as_posix(): path for path in found}
    return _sha256(files)


def module_blobs(sources: Path = SOURCES) -> dict[str, str]:
    """Returns git's hash of the file of every module of this package, by the module's name.

    `git log --all --find-object=HASH` lists the commits in which a file came or went.
    """
    package = sources / "charms_bench"
    found = {}
    for path in sorted(package.rglob("*.py")):
        data = path.read_bytes()
        name = ".".join(path.relative_to(sources).with_suffix("").parts)
        blob = sha1(b"blob %d\0" % len(data) + data, usedforsecurity=False)
        found[name.removesuffix(".__init__")] = blob.hexdigest()
    return found


def commit() -> str:
    """Returns the commit that this package was installed from, or "" if it is not known.

    pip notes it when it installs from a repository; a checkout has it, too. A checkout whose
    modules have been edited is not that of a commit.
    """
    try:
        noted = json.loads(distribution("charms-bench").read_text("direct_url.json") or "{}")
        if "vcs_info" in noted:
            return str(noted["vcs_info"]["commit_id"])
        if not (SOURCES / ".git").exists():
            return ""
        edited = _git("status", "--porcelain", "--", "charms_bench/*.py")
        return "" if edited else _git("rev-parse", "HEAD")
    except (OSError, ValueError, KeyError, PackageNotFoundError, subprocess.SubprocessError):
        return ""


def _git(*words: str) -> str:
    command = ["git", "--no-optional-locks", "-C", str(SOURCES), *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def _sha256(files: Mapping[str, Path]) -> str:
    """Returns the hash of the names and contents of files."""
    digest = sha256()
    for name, path in sorted(files.items()):
        digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def differences(found: Mapping[str, str | None], expected: Mapping[str, str | None]) -> str:
    """Returns in words where what was found differs from what was expected."""
    return "; ".join(
        f"{name} is {found.get(name) or 'missing'}, expected {wanted}"
        for name, wanted in expected.items()
        if found.get(name) != wanted
    )
