"""The linters, the type checker and the build of the documentation find nothing."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMMANDS = (
    "mypy",
    "mkdocs build --strict --site-dir {folder}",
    "lint-imports",
    "ruff check .",
    "ruff format --check .",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_project_passes(command: str, tmp_path: Path) -> None:
    program, *arguments = command.format(folder=tmp_path).split()
    path = Path(sys.executable).with_name(program)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(("agents", "baselines"))}
    ran = subprocess.run(
        [path, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


LARGE = ("agents/charms_agents/policies/*.onnx", "networks/*/*.onnx")
"""The only tracked files that may be above `FILE_LIMIT`."""
FILE_LIMIT, ALL_LIMIT = 160_000, 20_000_000


def test_tracked_files_are_small() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("needs a checkout")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    paths = map(Path, listed.stdout.decode().strip("\0").split("\0"))
    sizes = {path: (ROOT / path).lstat().st_size for path in paths if (ROOT / path).is_file()}
    large = [path for path, size in sizes.items() if size > FILE_LIMIT]
    assert [str(path) for path in large if not any(map(path.match, LARGE))] == []
    assert sum(sizes.values()) <= ALL_LIMIT


WORDS = {"refuse": "reject", "refusal": "rejection", "refused": "rejected", "recipe": "training",
         "standing": "stationary"}  # fmt: skip
"""Words that names do not have, and what they have instead."""


def test_names_have_the_words_of_the_field() -> None:
    files = [path for part in ("charms_bench", "agents", "baselines", "tools", "tests")
             for path in (ROOT / part).rglob("*.py") if "golden" not in path.parts]  # fmt: skip
    found = {}
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(node, "name", None) or getattr(node, "id", None)
            for word in str(name).lower().split("_") if name else ():
                if word in WORDS:
                    found[f"{path.relative_to(ROOT)}: {name}"] = WORDS[word]
    assert len(files) > 500
    assert found == {}
