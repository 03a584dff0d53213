"""Progress of long work: a bar on a terminal, one line at every tenth elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from charms_bench.foundation.compiled import is_kept
from charms_bench.foundation.streams import QUIET

if TYPE_CHECKING:
    from rich.progress import Progress

ENGINE = "the engine (once, about half a minute)"
ENGINE_OF_ROADS = "the engine of highway-env's roads (once, one or two minutes)"
Tell = Callable[[str, int], None]
"""Called with what is being worked on and the number of units finished since the last call."""


def printable(text: str) -> str:
    """Text without control characters and without Rich markup: names come from users."""
    return escape("".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text))


def note(text: str) -> None:
    """Prints a message on standard error, apart from the results."""
    if not QUIET.get():
        Console(stderr=True, emoji=False).print(printable(text), highlight=False, soft_wrap=True)


@cache
def note_compiling(function: Any, engine: str) -> None:
    """Says, once, that the first call of a function compiles an engine, if it does."""
    if not is_kept(function):
        note(f"compiling {engine}")


@contextmanager
def progress(unit: str, total: int) -> Iterator[Tell]:
    """Shows how many of `total` units, such as `episodes`, are finished, on standard error."""
    if QUIET.get():
        yield lambda what, count: None
        return
    # FORCE_COLOR asks for colours in a file, not for a bar that is drawn again and again.
    interactive = None if sys.stderr.isatty() else False
    console = Console(stderr=True, emoji=False, force_interactive=interactive)
    if not console.is_interactive:
        yield _lines(console, unit, total)
        return
    with _bar(console, unit) as bar:
        task = bar.add_task("", total=total)
        yield lambda what, count: bar.update(task, description=printable(what), advance=count)


def _lines(console: Console, unit: str, total: int) -> Tell:
    done = 0

    def tell(what: str, count: int) -> None:
        nonlocal done
        before, done = done, done + count
        if before * 10 // total < done * 10 // total:
            console.print(f"{done:,} of {total:,} {unit}", highlight=False)

    return tell


def _bar(console: Console, unit: str) -> "Progress":
    from rich import progress as rich
    from rich.text import Text

    class Rate(rich.ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.speed:,.0f}/s" if task.speed else "")

    return rich.Progress(
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.MofNCompleteColumn(),
        rich.TextColumn(unit),
        Rate(),
        rich.TimeElapsedColumn(),
        rich.TimeRemainingColumn(),
        console=console,
        transient=True,
    )
