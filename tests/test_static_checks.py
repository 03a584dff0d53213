"""The linters, the type checker and the build of the documentation find nothing."""

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
