"""The pipeline `charms`: a training suite -> networks, stage by stage."""

import hashlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from charms_agents.training.curve import Point
from charms_agents.training.job import Job, StageFolder
from charms_agents.training.settings import TrainingSuite, load_training
from charms_agents.training.stage import Interrupted, train_stage
from charms_bench.agent import Policy
from charms_bench.errors import InputError
from charms_bench.registry import make_agent


def run(
    suite_file: Path, output: Path, workers: int | None = None, only: str | None = None
) -> None:
    """Trains the stages of a suite, or goes on with them; a finished one is never trained again.

    Args:
        suite_file: The training suite.
        output: The run folder; every stage has its own in it, named after its inputs.
        workers: Unused: every stage so far waits for the one before.
        only: The stage to train, with what it needs; by default all.

    Raises:
        KeyboardInterrupt: The training was interrupted; `output` holds a checkpoint.
        InputError: The suite or the run folder cannot be used.
    """
    suite = load_training(suite_file)
    suite_sha256 = hashlib.sha256(suite_file.read_bytes()).hexdigest()
    if only is not None and only not in suite.stages:
        raise InputError(
            f"{suite_file}: no stage named '{only}'; it has: {', '.join(suite.stages)}"
        )
    names = suite.order if only is None else suite.needed_for(only)
    console = Console(stderr=True)
    finished: dict[str, StageFolder] = {}
    with _stop_on_ctrl_c() as stop:
        for name in names:
            job = _job(name, suite, finished)
            folder = StageFolder(output, job)
            if folder.finished:
                console.print(f"{name}: finished before, in {folder.path}", highlight=False)
            else:
                with _progress(console, name, job.stage.steps) as report:
                    try:
                        train_stage(job, output, suite_sha256, report, stop)
                    except Interrupted:
                        raise KeyboardInterrupt from None
                console.print(f"{name}: finished, in {folder.path}", highlight=False)
            finished[name] = folder


def _job(name: str, suite: TrainingSuite, finished: dict[str, StageFolder]) -> Job:
    """A stage, once those it needs are finished."""
    stage = suite.stages[name]
    agent, before = stage.traffic.agent, stage.traffic.stage
    if before is None:
        return Job(name, stage, suite, str(agent), None, _weights_sha256(str(agent)))
    network = finished[before].network
    sha256 = hashlib.sha256(network.read_bytes()).hexdigest()
    job = Job(name, stage, suite, before, network, sha256)
    if agent is None:
        return job
    share = stage.traffic.agent_share or 0.0
    return replace(
        job, mixed_in=agent, mixed_in_share=share, mixed_in_sha256=_weights_sha256(agent)
    )


def _weights_sha256(agent: str) -> str:
    """Hash of an installed agent's weights; empty where it has none."""
    made = make_agent(agent)
    return made.weights_sha256 if isinstance(made, Policy) else ""


@contextmanager
def _stop_on_ctrl_c() -> Iterator[Callable[[], bool]]:
    """Turns the first Ctrl-C into a wish that the training grants; a second one ends it at once."""
    wished = threading.Event()

    def wish(number: int, frame: FrameType | None) -> None:
        wished.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    if threading.current_thread() is not threading.main_thread():
        yield wished.is_set
        return
    before = signal.signal(signal.SIGINT, wish)
    try:
        yield wished.is_set
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _progress(
    console: Console, name: str, total: int
) -> Iterator[Callable[[int, Point | None], None]]:
    """A bar on a terminal; a line at every tenth of the steps elsewhere."""
    if not console.is_terminal:
        tenth = 0

        def say(steps: int, point: Point | None) -> None:
            nonlocal tenth
            if point is not None and steps * 10 // total > tenth:
                tenth = steps * 10 // total
                print(f"{name}: {steps:,} of {total:,} steps{_words(point)}", file=sys.stderr)

        yield say
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[point]}"),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=total, point="")

        def move(steps: int, point: Point | None) -> None:
            progress.update(task, completed=steps)
            if point is not None:
                progress.update(task, point=_words(point).removeprefix(", "))

        yield move


def _words(point: Point) -> str:
    if point.return_mean is None or point.crashed_share is None:
        return ""
    return f", return {point.return_mean:.1f}, {point.crashed_share:.0%} crashed"
