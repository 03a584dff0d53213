"""What all commands share: the app, the two streams, common options, interruption."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from functools import cache
from os import _exit  # see `exits_are_exceptions`
from pathlib import Path
from select import select
from shlex import quote
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import typer
from typer import Option
from typer.core import TyperGroup

from charms_bench.errors import InputError
from charms_bench.foundation.streams import QUIET

if TYPE_CHECKING:
    from rich.console import Console

    from charms_bench.report.table import Table

FAIL, MISTAKE, UNKNOWN, OUR_BUG = 1, 2, 3, 70
"""Exit codes; a command that a signal ends has 128 and the signal's number."""
EXITS = {
    0: "success, and everything that was checked passes",
    FAIL: "something that was checked fails (check, verify, audit)",
    MISTAKE: "a mistake in an option, a file or a plugin",
    UNKNOWN: "nothing fails, but something cannot be checked (audit)",
    OUR_BUG: "a bug of charms-bench, with a traceback",
    130: "stopped by Ctrl-C",
    141: "the reader of the output has left",
    143: "stopped by SIGTERM",
}


class _InGroups(TyperGroup):
    """Lists the commands by their groups; typer's own plain help has no groups."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        width = max(map(len, self.commands))
        groups: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            line = command.get_short_help_str(formatter.width)
            groups.setdefault(getattr(command, "rich_help_panel", ""), []).append(
                (name.ljust(width), line)
            )
        for title, lines in groups.items():
            with formatter.section(title):
                formatter.write_dl(lines)


app = typer.Typer(
    name="charms-bench",
    cls=_InGroups,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    epilog="Exit codes: " + "; ".join(f"{code}: {what}" for code, what in EXITS.items()) + ".",
    context_settings={"help_option_names": ["-h", "--help"]},
)
ANYWHERE = ("--quiet", "--verbose")
"""Options of charms-bench itself, which may also follow the name of a command."""
VERBOSE: ContextVar[bool] = ContextVar("VERBOSE", default=False)
_ANSWER: ContextVar[TextIO | None] = ContextVar("_ANSWER", default=None)
"""Where `end_with_json` prints; None is standard output."""


@cache
def _only_ours(output: TextIO) -> TextIO:
    """A stream to where `output` goes; whatever else is printed goes to standard error from now on.

    A plugin can print through its libraries, its child processes, or when Python exits. So this
    process redirects the descriptor itself, and for good.
    """
    try:
        descriptor = output.fileno()
    except OSError:  # in tests, it is not a file
        return output
    # It stays open until the process ends.
    ours = open(os.dup(descriptor), "w", encoding=output.encoding, errors="replace")  # noqa: SIM115
    elsewhere = sys.stderr.fileno() if sys.stderr else os.open(os.devnull, os.O_WRONLY)
    os.dup2(elsewhere, descriptor)
    return ours


def print_only_json(context: typer.Context, wanted: bool) -> bool:
    if wanted:
        answer = sys.stdout or open(os.devnull, "w")  # noqa: SIM115  # open until the process ends
        before = _ANSWER.set(_only_ours(answer))
        context.call_on_close(lambda: _ANSWER.reset(before))
        context.with_resource(redirect_stdout(sys.stderr))
    return wanted


END_S = 2.0
"""Seconds after a second signal that a command has to end by itself."""


@cache
def out() -> "Console":
    """Standard output."""
    from rich.console import Console

    class Output(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError  # for `main`; rich would end the process with exit code 1

    # A file has no width of its own; 80 would cut tables.
    columns = os.environ.get("COLUMNS", "")
    if not (columns.isdigit() and columns.strip("0")):
        os.environ.pop("COLUMNS", None)
    has_width = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Output(emoji=False, width=None if has_width else 120)


@cache
def err() -> "Console":
    """Standard error."""
    from rich.console import Console

    return Console(stderr=True, emoji=False)


def _print_version(wanted: bool) -> None:
    if wanted:
        from charms_bench import __version__

        print(f"charms-bench {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = Option(
        False,
        "--version",
        callback=_print_version,
        is_eager=True,
        help="Print the version and exit.",
    ),
    quiet: bool = Option(False, ANYWHERE[0], help="Print results and errors, but no progress."),
    verbose: bool = Option(False, ANYWHERE[1], help="Print where in the code an error was raised."),
) -> None:
    """Benchmark driving behaviour on highway-env's roads and on road maps."""
    QUIET.set(quiet)
    VERBOSE.set(verbose)


@contextmanager
def interruptible() -> Iterator[None]:
    """Turns Ctrl-C and SIGTERM into a message about what is kept, and exit code 130 or 143."""
    arrived = signal.SIGINT

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal arrived
        arrived = signal.Signals(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt as error:
        kept = "; ".join(getattr(error, "__notes__", ()))
        rest = f"; {kept}, and the same command continues there" if kept else ""
        say(f"interrupted{rest}", err())
        raise typer.Exit(128 + arrived) from None
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def ended_by_second_signal() -> Iterator[None]:
    """Ends this process soon after a second Ctrl-C or SIGTERM, whatever it is doing within.

    While a library computes, Python's own handlers wait for it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived, wakeup = os.pipe()
    os.set_blocking(wakeup, False)
    before = signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)
    threading.Thread(target=_end_at_second, args=(arrived,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(wakeup)


def _end_at_second(arrived: int) -> None:
    """Ends this process when two signals have arrived, unless the pipe is closed soon."""
    signals: list[int] = []
    until: float | None = None
    while select([arrived], [], [], until and max(0.0, until - time.monotonic()))[0]:
        numbers = os.read(arrived, 64)
        if not numbers:
            os.close(arrived)
            return
        signals += (each for each in numbers if each in (signal.SIGINT, signal.SIGTERM))
        if len(signals) > 1 and until is None:
            until = time.monotonic() + END_S
    os.write(2, b"interrupted again; ended at once\n")
    _exit(128 + signals[-1])  # its workers notice


@contextmanager
def exits_are_exceptions() -> Iterator[None]:
    """Lets `os._exit` raise a `SystemExit` within, so that a plugin that calls it is named.

    Otherwise it ends a command in silence, with any exit code.
    """
    os._exit = sys.exit  # type: ignore[assignment]  # it leaves no frame in tracebacks
    try:
        yield
    finally:
        _end_for_good()


def _end_for_good() -> None:
    os._exit = _exit


os.register_at_fork(after_in_child=_end_for_good)  # copies of this process end so


def print_table(table: "Table", stacked: bool = False) -> None:
    """Prints a table as wide as the terminal; see `report.terminal.grid`."""
    from charms_bench.report.terminal import grid

    out().print(grid(table, out().width, stacked))


def print_records(
    key: str, records: Iterable[Mapping[str, Any]], forms: Mapping[str, str], as_json: bool = False
) -> None:
    """Prints a table with these columns beside `key`, or ends the command with JSON.

    Forms are as in `Column`.
    """
    if as_json:
        end_with_json(records)
    from charms_bench.report.table import Table

    print_table(Table.plain(records, (key,), forms))


def print_facts(facts: Mapping[str, str]) -> None:
    """Prints a table of facts and their values."""
    records = [{"fact": fact, "found": value} for fact, value in facts.items()]
    print_records("fact", records, {"found": ""})


def end_with_json(value: Any, code: int = 0) -> NoReturn:
    """Prints a value as JSON on standard output, and ends the command with an exit code."""
    import json

    answer = _ANSWER.get()
    try:
        print(json.dumps(value, indent=2, ensure_ascii=False), file=answer, flush=True)
    except OSError as error:
        if answer is not None:  # else Python tries once more when it exits, and complains
            os.dup2(os.open(os.devnull, os.O_WRONLY), answer.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError(f"standard output: cannot be written: {error.strerror}") from error
    raise typer.Exit(code)


def shown(path: Path) -> str:
    """A path as users would type it: from the current folder if it is in there."""
    try:
        return str(path.relative_to(Path.cwd()))
    except (OSError, ValueError):  # the current folder is another one, or has been deleted
        return str(path)


def as_word(path: Path) -> str:
    """A path as a word of a command of the shell."""
    return quote(shown(path))


def say(text: str, console: "Console | None" = None) -> None:
    """Prints text as it is: without markup, highlighting or line breaks of its own."""
    from charms_bench.foundation.progress import printable

    (console or out()).print(printable(text), highlight=False, soft_wrap=True)
