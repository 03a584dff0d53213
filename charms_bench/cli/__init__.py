"""The command line: a thin layer over `charms_bench.api`, one module per group of commands.

Commands import what they need when they run, so that `--help` is quick.
"""

import gc
import os
import signal
import sys
import traceback
from importlib.util import find_spec
from pathlib import Path

from charms_bench.cli.terminal import (
    ANYWHERE,
    MISTAKE,
    OUR_BUG,
    VERBOSE,
    app,
    ended_by_second_signal,
    err,
    exits_are_exceptions,
    say,
)
from charms_bench.errors import CharmsBenchError, InputError, named
from charms_bench.foundation.files import absolute
from charms_bench.foundation.streams import write_reliably

# In the order of `--help`. Importing a module adds its commands to `app`.
from charms_bench.cli import evaluations, episodes, watching, plugins, engines, data, maps  # isort: skip # noqa: F401

MESSAGE_LIMIT = 1000
"""Characters of an error message: a file from outside can make it very long."""
LEAST = {"NUMBA_NUM_THREADS": 1, "POLARS_MAX_THREADS": 1, "SOURCE_DATE_EPOCH": 0}
"""Environment variables that libraries read when they are imported, and their least values."""
NUMBA_FILE = ".numba_config.yaml"


def _check_environment() -> None:
    """Raises an `InputError` for what a library would read here, or end the process for."""
    if os.path.exists(NUMBA_FILE):
        raise InputError(
            f"{NUMBA_FILE}: numba would read this file of the current folder; change to another "
            "folder"
        )
    for name, least in LEAST.items():
        value = os.environ.get(name, "")
        if value and not (value.isascii() and value.isdigit() and int(value[:20]) >= least):
            raise InputError(
                f"{name} is {value[:80]!r}; expected a whole number from {least}; unset it"
            )


def _use_own_style() -> None:
    """Lets no `matplotlibrc` of the current folder or of the user's change a figure.

    Raises an `InputError` if matplotlib cannot read that of the current folder, its first choice.
    """
    os.environ["MPLBACKEND"] = "agg"  # commands draw into files
    package = find_spec("matplotlib")
    if package is not None and package.origin is not None:
        defaults = Path(package.origin).parent / "mpl-data" / "matplotlibrc"
        os.environ["MATPLOTLIBRC"] = str(defaults)
    if os.path.exists("matplotlibrc"):
        try:
            import matplotlib
        except Exception as error:
            raise InputError(
                f"matplotlibrc: matplotlib cannot read this file of the current folder "
                f"({named(error)}); correct it, or change to another folder"
            ) from error
        matplotlib.rcdefaults()


def _arguments(words: list[str]) -> list[str]:
    """The arguments with the options `ANYWHERE` before the name of the command."""
    end = words.index("--") if "--" in words else len(words)
    first = [word for word in words[:end] if word in ANYWHERE]
    return [*first, *(word for word in words[:end] if word not in ANYWHERE), *words[end:]]


def _explain(what: str, error: Exception) -> None:
    if len(what) > MESSAGE_LIMIT:
        what = f"{what[: MESSAGE_LIMIT // 2]} ... {what[-MESSAGE_LIMIT // 2 :]}"
    err().print("[bold red]error:[/] ", end="")
    say(what, err())
    if VERBOSE.get():
        traceback.print_exception(error)


def _of_the_machine(error: Exception) -> str:
    """What a file system, or the limits of this process, do not permit; empty for other errors."""
    if isinstance(error, OSError) and error.strerror:
        if error.filename is not None:
            return f"{os.fsdecode(error.filename)}: {error.strerror}"
        try:
            absolute(".")
        except InputError as deleted:
            return str(deleted).removeprefix(".: ")
        return error.strerror
    if isinstance(error, MemoryError):
        return "not enough memory"
    if isinstance(error, RuntimeError) and "start new thread" in str(error):
        return "not enough memory, or too many threads"
    return ""


def main() -> None:
    """Runs the command line; see `terminal.EXITS` for how it ends."""
    gc.set_threshold(100_000)  # most objects live until the end of a command
    write_reliably()
    try:
        _check_environment()
        _use_own_style()
        try:
            with ended_by_second_signal(), exits_are_exceptions():
                app(_arguments(sys.argv[1:]))
        finally:
            sys.stdout.flush()  # not when Python exits, where an error would be lost
    except CharmsBenchError as error:
        _explain("; ".join([str(error), *getattr(error, "__notes__", ())]), error)
        sys.exit(MISTAKE)
    except BrokenPipeError:  # the reader has left, as in `charms-bench ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # typer has turned it into exit code 1
            sys.exit(128 + signal.SIGPIPE)
        raise
    except Exception as error:
        if what := _of_the_machine(error):
            _explain(what, error)
            sys.exit(MISTAKE)
        traceback.print_exc()
        say("This is a bug of charms-bench. Please report it with the lines above.", err())
        sys.exit(OUR_BUG)
    finally:
        gc.freeze()  # so that Python does not collect everything once more when it exits
