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
