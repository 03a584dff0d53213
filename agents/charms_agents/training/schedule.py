"""Runs stages in the order of what they need, side by side where there are workers for it."""

import multiprocessing
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from graphlib import TopologicalSorter
from pathlib import Path
from queue import Empty
from typing import Any

from charms_agents.training.curve import Point
from charms_agents.training.human_stage import HumanJob, fit_stage
from charms_agents.training.job import Job, StageFolder
from charms_agents.training.progress import Tell
from charms_agents.training.stage import Interrupted, train_stage
from charms_agents.training.supervised import Epoch
from charms_bench.errors import RunFolderError
from charms_bench.runs.workers import start_worker

AnyJob = Job | HumanJob
Needs = Mapping[str, Sequence[str]]
"""The stages that each stage needs, by name."""
MakeJob = Callable[[str, Mapping[str, StageFolder]], AnyJob]
"""The job of a stage, from the folders of those that are finished."""

POLL_S = 0.2
_told: Any = None
_stopping: Any = None


def run_stages(
    needs: Needs,
    make_job: MakeJob,
    output: Path,
    suite_sha256: str,
    workers: int,
    tell: Tell,
    said: Callable[[str], None],
    stop: Callable[[], bool],
) -> dict[str, StageFolder]:
    """Trains stages that are not finished, in processes unless only one can run at a time.

    Args:
        needs: All stages, and what each of them needs.
        make_job: Called once what a stage needs is finished.
        output: Where their folders are.
        suite_sha256: For their manifests.
        workers: Most stages at a time.
        tell: Told how they go.
        said: Told when one is finished.
        stop: Whether to write checkpoints and stop.

    Returns:
        All folders, by stage.

    Raises:
        Interrupted: `stop` said so.
        CharmsBenchError: The first that a stage raised, after the others have written checkpoints.
    """
    workers = min(workers, _width(needs))
    finished: dict[str, StageFolder] = {}
    sorter = TopologicalSorter(needs)
    sorter.prepare()

    def begin(name: str) -> AnyJob | None:
        """A stage's job; none where it was finished before."""
        job = make_job(name, finished)
        folder = StageFolder(output, job)
        if not folder.finished:
            return job
        said(f"{name}: finished before, in {folder.path}")
        end(name, folder)
        return None

    def end(name: str, folder: StageFolder) -> None:
        finished[name] = folder
        sorter.done(name)

    def ended(name: str, folder: StageFolder) -> None:
        said(f"{name}: finished, in {folder.path}")
        end(name, folder)

    if workers == 1:
        while sorter.is_active():
            for name in sorter.get_ready():
                if job := begin(name):
                    ended(name, train(job, output, suite_sha256, tell, stop))
        return finished

    context = multiprocessing.get_context("spawn")
    told, stopping = context.Queue(), context.Event()
    executor = ProcessPoolExecutor(workers, context, _start_worker, (told, stopping))
    running: dict[Future[StageFolder], str] = {}
    try:
        while sorter.is_active():
            for name in sorter.get_ready():
                if job := begin(name):
                    running[executor.submit(_train_in_worker, job, output, suite_sha256)] = name
            done, _ = wait(running, timeout=POLL_S, return_when=FIRST_COMPLETED)
            _pass_on(told, tell)
            if stop():
                raise Interrupted
            for future in done:
                ended(running.pop(future), future.result())
    except BrokenProcessPool as error:
        if stop():  # a signal to all processes alike
            raise Interrupted from error
        raise RunFolderError(
            f"a stage's process died; checkpoints are in {output}, "
            "and the same command goes on from there"
        ) from error
    finally:
        stopping.set()
        for future in running:
            future.cancel()
        while wait(running, timeout=POLL_S).not_done:
            _pass_on(told, tell)  # a process ends only once its queue is read
        executor.shutdown()
    return finished


def _width(needs: Needs) -> int:
    """The most stages that could ever run side by side."""
    sorter = TopologicalSorter(needs)
    sorter.prepare()
    width = 1
    while sorter.is_active():
        ready = sorter.get_ready()
        width = max(width, len(ready))
        sorter.done(*ready)
    return width


def train(
    job: AnyJob, output: Path, suite_sha256: str, tell: Tell, stop: Callable[[], bool]
) -> StageFolder:
    """Trains a stage in this process; see `train_stage` and `fit_stage`."""
    if isinstance(job, HumanJob):

        def report_epoch(point: Epoch) -> None:
            tell(job.name, point.epoch, job.steps, in_words(point))

        return fit_stage(job, output, suite_sha256, report_epoch, stop)

    def report(steps: int, point: Point | None) -> None:
        tell(job.name, steps, job.stage.steps, in_words(point) if point else "")

    return train_stage(job, output, suite_sha256, report, stop)


def in_words(point: Point | Epoch) -> str:
    """How a stage goes."""
    if isinstance(point, Epoch):
        agrees = "" if point.agreement is None else f", agrees with {point.agreement:.1%}"
        return f"loss {point.loss:.3f}{agrees}"
    if point.return_mean is None or point.crashed_share is None:
        return ""
    return f"return {point.return_mean:.1f}, {point.crashed_share:.0%} crashed"


def _pass_on(told: Any, tell: Tell) -> None:
    """Tells what workers told."""
    while True:
        try:
            tell(*told.get_nowait())
        except Empty:
            return


def _start_worker(told: Any, stopping: Any) -> None:
    """Gives the worker its ways to talk to the parent."""
    global _told, _stopping
    _told, _stopping = told, stopping
    start_worker()


def _train_in_worker(job: AnyJob, output: Path, suite_sha256: str) -> StageFolder:
    last = 0.0

    def tell(stage: str, done: int, total: int, words: str) -> None:
        nonlocal last
        if words or time.monotonic() - last > POLL_S:
            last = time.monotonic()
            _told.put((stage, done, total, words))

    return train(job, output, suite_sha256, tell, _stopping.is_set)
