"""A plugin's folder as if it were installed: its modules and what pip would know of it."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

from charms_bench.foundation.workers import _end_spare


def installed(folder: Path) -> dict[str, str]:
    """The environment of processes that find the distribution in `folder`, with its metadata.

    A worker that an earlier test has left would not find it, and ends.
    """
    _end_spare()
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    known = folder / f"{project['name']}-0.1.dist-info"
    known.mkdir()
    (known / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1\n"
    )
    groups = project["entry-points"].items()
    lines = [
        line
        for group, points in groups
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in points.items()))
    ]
    (known / "entry_points.txt").write_text("\n".join(lines))
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "100", "NO_COLOR": "1"}


def python(
    arguments: list[str], folder: Path, environment: dict[str, str]
) -> subprocess.CompletedProcess[str]:
    """What became of `python -m` with these arguments."""
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
