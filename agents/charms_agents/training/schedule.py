"""Trains the stages of a suite in the order of their needs, side by side where possible."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from graphlib import TopologicalSorter
from operator import attrgetter

from charms_agents.training.job import Job
from charms_agents.training.stage import Interrupted, train_stage
from charms_agents.training.stage_progress import Tell
from charms_bench.errors import WorkerError
from charms_bench.foundation.workers import Pool, stop_requested
from charms_bench.foundation.workers import tell as tell_parent

Needs = Mapping[str, Sequence[str]]
"""The stages that each stage needs, by name."""
POLL_S = 0.2


def run_stages(
    needs: Needs,
    make_job: Callable[[str, Mapping[str, Job]], Job],
    suite_sha256: str,
    workers: int,
    tell: Tell,
    say: Callable[[str], None],
    stop: Callable[[], bool],
) -> dict[str, Job]:
    """Trains the stages that are not finished; returns all jobs, by stage.

    Stages are trained in worker processes; in this one if only one can be trained at a time.

    Args:
        needs: All stages, and the stages that each of them needs.
        make_job: Makes the job of a stage, from the jobs of all stages that are finished.
        workers: Most stages to train at a time.
        tell: Told of the progress of each stage.
        say: Told when a stage is finished.
        stop: Whether to write checkpoints and stop.

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
        say(f"{job.name}: {how}, in {job.folder}")
        finished[job.name] = job
        sorter.done(job.name)

    if workers == 1:
        while sorter.is_active():
            for job in ready():
                train_stage(job, suite_sha256, tell, stop)
                end(job)
        return finished

    work = partial(_train_in_worker, suite_sha256)
    title = attrgetter("name")
    with Pool(work, workers, title, notice=say, told=lambda words: tell(*words)) as pool:
        try:
            while sorter.is_active():
                pool.add(ready())
                for job, _ in pool.results(POLL_S):
                    end(job)
                if stop():
                    raise Interrupted
        except Exception as error:
            if isinstance(error, WorkerError):
                error.add_note("the same command continues from the last checkpoints")
            pool.stop()
            for _ in pool.results():
                pass
            raise
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


def _train_in_worker(suite_sha256: str, job: Job) -> None:
    last = 0.0

    def tell(stage: str, done: int, total: int, words: str) -> None:
        nonlocal last
        if words or time.monotonic() - last > POLL_S:
            last = time.monotonic()
            tell_parent((stage, done, total, words))

    with suppress(Interrupted):  # the parent has asked for it
        train_stage(job, suite_sha256, tell, stop_requested)
