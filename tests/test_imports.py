"""What import-linter does not check: private names, and what `--help` imports."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PLUGINS = (Path("baselines/charms_baselines"), Path("agents/charms_agents"))


def modules(*folders: Path) -> list[Path]:
    return [path for folder in folders for path in sorted(folder.rglob("*.py"))]


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """Every imported module, and the name imported from it if any."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from ((str(node.module), alias.name) for alias in node.names)


@pytest.mark.parametrize("path", modules(*PLUGINS), ids=str)
def test_plugins_import_public_names_only(path: Path) -> None:
    for module, name in imported(path):
        if module.split(".")[0] == "charms_bench":
            private = [part for part in (*module.split("."), name) if part.startswith("_")]
            assert not private, f"{path} imports {module}.{name}"


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, charms_bench.cli; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    heavy = {"numba", "polars", "onnxruntime", "numpy", "pydantic", "highway_env", "rich.console"}
    assert not heavy & set(loaded)
