"""Trains the stages of a suite in the order of their needs, side by side where possible."""

import multiprocessing
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from graphlib import TopologicalSorter
from queue import Empty
from typing import Any

from charms_agents.training.job import Job
from charms_agents.training.progress import Tell
from charms_agents.training.stage import Interrupted, train_stage
from charms_bench.errors import RunFolderError
from charms_bench.runs.workers import start_worker, starting

Needs = Mapping[str, Sequence[str]]
"""The stages that each stage needs, by name."""
POLL_S = 0.2
_told: Any = None
_stopping: Any = None


def run_stages(
    needs: Needs,
    make_job: Callable[[str, Mapping[str, Job]], Job],
    suite_sha256: str,
    workers: int,
    tell: Tell,
    say: Callable[[str], None],
    stop: Callable[[], bool],
) -> dict[str, Job]:
    """Trains the stages that are not finished.

    Stages are trained in worker processes, or in this process if only one can be trained at a
    time.

    Args:
        needs: All stages, and the stages that each of them needs.
        make_job: Makes the job of a stage, from the jobs of all stages that are finished.
        suite_sha256: For the manifests.
        workers: Most stages to train at a time.
        tell: Told of the progress of each stage.
        say: Told when a stage is finished.
        stop: Whether to write checkpoints and stop.

    Returns:
        All jobs, by stage.

    Raises:
        Interrupted: `stop` returned True.
        CharmsBenchError: The first error of a stage; the other stages have written checkpoints.
    """
    workers = min(workers, _width(needs))
    finished: dict[str, Job] = {}
    sorter = TopologicalSorter(needs)
    sorter.prepare()

    def ready() -> list[Job]:
        """The jobs that can start now."""
        jobs = []
        for name in sorter.get_ready():
            job = make_job(name, finished)
            if job.finished:
                end(job, "was finished before")
            else:
                jobs.append(job)
        return jobs

    def end(job: Job, how: str = "finished") -> None:
        say(f"{job.title}: {how}, in {job.folder}")
        finished[job.title] = job
        sorter.done(job.title)

    if workers == 1:
        while sorter.is_active():
            for job in ready():
                train_stage(job, suite_sha256, tell, stop)
                end(job)
        return finished

    context = multiprocessing.get_context("spawn")
    told, stopping = context.Queue(), context.Event()
    executor = ProcessPoolExecutor(workers, context, _start_worker, (told, stopping))
    running: dict[Future[None], Job] = {}
    try:
        while sorter.is_active():
            for job in ready():
                with starting({}):
                    running[executor.submit(_train_in_worker, job, suite_sha256)] = job
            done, _ = wait(running, timeout=POLL_S, return_when=FIRST_COMPLETED)
            _pass_on(told, tell)
            if stop():
                raise Interrupted
            for future in done:
                future.result()
                end(running.pop(future))
    except BrokenProcessPool as error:
        if stop():  # a signal that reached all processes
            raise Interrupted from error
        raise RunFolderError(
            f"a stage's process died; checkpoints are in {job.output}, "
            "and the same command continues from there"
        ) from error
    finally:
        stopping.set()
        for future in running:
            future.cancel()
        while wait(running, timeout=POLL_S).not_done:
            _pass_on(told, tell)  # a process ends only when its queue has been read
        executor.shutdown()
    return finished


def _width(needs: Needs) -> int:
    """The largest number of stages that can be trained at the same time."""
    sorter = TopologicalSorter(needs)
    sorter.prepare()
    width = 1
    while sorter.is_active():
        ready = sorter.get_ready()
        width = max(width, len(ready))
        sorter.done(*ready)
    return width


def _pass_on(told: Any, tell: Tell) -> None:
    """Tells everything that workers have told so far."""
    while True:
        try:
            tell(*told.get_nowait())
        except Empty:
            return


def _start_worker(told: Any, stopping: Any) -> None:
    """Keeps the worker's connections to its parent."""
    global _told, _stopping
    _told, _stopping = told, stopping
    start_worker()


def _train_in_worker(job: Job, suite_sha256: str) -> None:
    last = 0.0

    def tell(stage: str, done: int, total: int, words: str) -> None:
        nonlocal last
        if words or time.monotonic() - last > POLL_S:
            last = time.monotonic()
            _told.put((stage, done, total, words))

    train_stage(job, suite_sha256, tell, _stopping.is_set)
