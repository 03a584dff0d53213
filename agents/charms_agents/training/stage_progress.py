"""Shows the progress of all stages that are being trained."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich import progress as rich
from rich.console import Console

Tell = Callable[[str, int, int, str], None]
"""Takes a stage's name, the steps done, the steps in total, and the last results in words."""


@contextmanager
def progress(console: Console) -> Iterator[Tell]:
    """Draws one bar per stage on a terminal; elsewhere, prints a line per tenth of a stage."""
    if not console.is_interactive:
        yield _lines()
        return
    columns = (
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.MofNCompleteColumn(),
        rich.TimeRemainingColumn(),
        rich.TextColumn("{task.fields[words]}"),
    )
    with rich.Progress(*columns, console=console) as bars:
        tasks: dict[str, rich.TaskID] = {}

        def move(stage: str, done: int, total: int, words: str) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total, words="")
            bars.update(tasks[stage], completed=done)
            if words:
                bars.update(tasks[stage], words=words)
            if done >= total:
                bars.remove_task(tasks.pop(stage))

        yield move


def _lines() -> Tell:
    tenths: dict[str, int] = {}

    def say(stage: str, done: int, total: int, words: str) -> None:
        tenth = done * 10 // total
        if words and tenth > tenths.get(stage, 0):
            tenths[stage] = tenth
            print(f"{stage}: {done:,} of {total:,}, {words}", file=sys.stderr)

    return say
