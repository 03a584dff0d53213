"""What somebody hostile, or unlucky, gives the command line."""

import io
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from charms_bench.cli import main

CANARY = "canary"
"""A folder that hostile input tries to make, by running code, in the working directory."""


class BadInput(NamedTuple):
    """Input that has to be refused."""

    title: str
    make: Callable[[Path], Sequence[object]]
    """Writes its files into a folder and returns the command line, run in that folder."""


class Answer(NamedTuple):
    """What the command line did."""

    code: int
    out: str
    err: str


def charms_bench(*arguments: object, folder: Path) -> Answer:
    """Runs the command line in this process; what it does not catch is raised."""
    out, err = io.StringIO(), io.StringIO()
    before = Path.cwd()
    os.chdir(folder)
    try:
        with (
            patch.object(sys, "argv", ["charms-bench", *map(str, arguments)]),
            redirect_stdout(out),
            redirect_stderr(err),
        ):
            main()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        os.chdir(before)
    return Answer(code, out.getvalue(), err.getvalue())
