"""Calls the command line inside the test process, which has imported everything already."""

import io
import os
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from charms_bench.cli import main, terminal


@dataclass(frozen=True)
class Called:
    """What became of a command."""

    returncode: int
    stdout: str
    stderr: str


def charms_bench(*arguments: object, cwd: Path | None = None, columns: int = 100) -> Called:
    """Calls `charms-bench` as if its output went into files of this many columns."""
    code = 0
    with (
        patch.object(sys, "argv", ["charms-bench", *map(str, arguments)]),
        patch.dict(os.environ, {"COLUMNS": str(columns), "NO_COLOR": "1"}),
        patch.object(terminal.out(), "_width", columns),
        chdir(cwd or Path()),
        redirect_stdout(_file()) as stdout,
        redirect_stderr(_file()) as stderr,
    ):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
    return Called(code, _text(stdout), _text(stderr))


def _file() -> io.TextIOWrapper:
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8")


def _text(file: io.TextIOWrapper) -> str:
    file.flush()
    return file.buffer.getvalue().decode()  # type: ignore[attr-defined]
