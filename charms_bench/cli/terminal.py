"""What all commands share: the app, its two streams, options, progress."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer import rich_utils

if TYPE_CHECKING:
    from rich.progress import Progress

app = typer.Typer(
    name="charms-bench",
    help="Benchmark driving behaviour on highway-env's motorway, compiled.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# A file has no width of its own; 80 would cut tables.
out = Console(emoji=False, width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else 120)
# FORCE_COLOR asks for colours in a file, not for a bar that is drawn again and again.
err = Console(stderr=True, emoji=False, force_interactive=None if sys.stderr.isatty() else False)
rich_utils.FORCE_TERMINAL = None  # Typer would take GitHub's log for a terminal

Json = Annotated[bool, typer.Option("--json", help="Print nothing but JSON on standard output.")]
Workers = Annotated[
    int | None, typer.Option(min=1, max=1024, help="Processes; by default one a core.")
]
MetricSets = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME[:OPTION=VALUE,...]",
        help="A metric set, as standard:ttc_s=2; may be given again. By default paper and "
        "standard.",
    ),
]
SuiteFile = Annotated[Path, typer.Argument(metavar="SUITE", help="The suite's YAML file.")]


@contextmanager
def interruptible(what_is_left: str) -> Iterator[None]:
    """Turns Ctrl-C and SIGTERM into a sentence about what is left, and exit code 130 or 143."""
    arrived = signal.SIGINT

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal arrived
        arrived = signal.Signals(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        err.print(
            f"interrupted; {plain(what_is_left)}, and the same command goes on from there",
            highlight=False,
            soft_wrap=True,
        )
        raise typer.Exit(128 + arrived) from None
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def progress(unit: str, total: int) -> Iterator[Callable[[str, int], None]]:
    """A bar with rate and remaining time on a terminal; a line every tenth elsewhere."""
    if not err.is_interactive:
        yield _lines(unit, total)
        return
    with _bar(unit) as progress:
        task = progress.add_task("", total=total)
        yield lambda what, count: progress.update(task, description=plain(what), advance=count)


def _lines(unit: str, total: int) -> Callable[[str, int], None]:
    done = 0

    def tell(what: str, count: int) -> None:
        nonlocal done
        before, done = done, done + count
        if before * 10 // total < done * 10 // total:
            err.print(f"{done:,} of {total:,} {unit}", highlight=False)

    return tell


def _bar(unit: str) -> "Progress":
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.speed:,.0f}/s" if task.speed else "")

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=err,
        transient=True,
    )


def note(what: str) -> None:
    """Says something beside the results."""
    err.print(plain(what), highlight=False, soft_wrap=True)


def plain(text: str) -> str:
    """Text as it is: what users wrote is no markup, and moves no cursor."""
    from rich.markup import escape

    return escape("".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text))
