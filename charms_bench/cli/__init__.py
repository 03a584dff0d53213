"""The command line, a module a group of commands.

Heavy imports stay inside commands, so that `--help` is quick.
"""

import io
import os
import sys

from charms_bench.cli.terminal import app, err, plain
from charms_bench.errors import CharmsBenchError

# In the order of `--help`; importing a module adds its commands to `app`, hence noqa.
# isort: off
from charms_bench.cli import run  # noqa: F401
from charms_bench.cli import show  # noqa: F401
from charms_bench.cli import plugins  # noqa: F401
from charms_bench.cli import new_agent  # noqa: F401
from charms_bench.cli import engines  # noqa: F401
from charms_bench.cli import episodes  # noqa: F401
from charms_bench.cli import compare  # noqa: F401
from charms_bench.cli import report  # noqa: F401
from charms_bench.cli import rescore  # noqa: F401
from charms_bench.cli import data  # noqa: F401
from charms_bench.cli import export  # noqa: F401

# isort: on


MESSAGE_LIMIT = 1000
"""Characters of an error."""


def main() -> None:
    """Runs the command line; a user's mistake is a message and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a log in ASCII gets question marks, no traceback
    try:
        app()
    except CharmsBenchError as error:
        what = "; ".join([str(error), *getattr(error, "__notes__", ())])
        if len(what) > MESSAGE_LIMIT:  # somebody's file says something very long
            what = f"{what[: MESSAGE_LIMIT // 2]} ... {what[-MESSAGE_LIMIT // 2 :]}"
        err.print(f"[bold red]error:[/] {plain(what)}", soft_wrap=True, highlight=False)
        sys.exit(2)
    except BrokenPipeError:  # whoever reads has seen enough, `charms-bench ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
