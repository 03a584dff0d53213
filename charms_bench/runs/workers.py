"""Worker processes: tasks go out, results come back, whatever dies or hangs on the way."""

import multiprocessing
import os
import platform
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

import numpy as np

from charms_bench.errors import CharmsBenchError, WorkerError

Task = TypeVar("Task")
Result = TypeVar("Result")

TRIES = 3
"""Workers that a task may cost before it is given up."""
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS")


def in_processes(
    work: Callable[[Task], Result],
    tasks: Iterable[Task],
    count: int,
    title: Callable[[Task], str] = str,
    limit_s: float | None = None,
    notice: Callable[[str], None] = lambda what: None,
) -> Generator[tuple[Task, Result], None, None]:
    """Each task with its result, as they finish; close it to end the workers at once.

    A worker that dies is replaced and its task given to another.

    Args:
        work: What is done with a task; found by name in the workers, as are all its arguments.
        tasks: What is to be done.
        count: Processes, of one thread each.
        title: What a task is called in messages.
        limit_s: How long a task may take, its worker's start included.
        notice: Told of workers that died.

    Raises:
        WorkerError: A task has cost `TRIES` workers, or took longer than `limit_s`.
        CharmsBenchError: `work` raised it.
    """
    waiting = deque((task, 1) for task in tasks)
    idle: list[_Worker] = []
    busy: dict[Connection, _Busy[Task]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < count:
                worker = idle.pop() if idle else _start(work)
                task, tries = waiting.popleft()
                busy[worker.connection] = _Busy(worker, task, tries, time.monotonic())
                worker.send(task)
            for connection in _answered(busy, limit_s, title):
                done = busy.pop(connection)
                try:
                    result = connection.recv()
                except (EOFError, OSError):
                    how = done.worker.death()
                    what = f"a worker process {how} at {title(done.task)}"
                    if done.tries == TRIES:
                        raise WorkerError(f"{what}, and so did {TRIES - 1} before it") from None
                    notice(f"{what}; another one takes over")
                    waiting.appendleft((done.task, done.tries + 1))
                    continue
                idle.append(done.worker)
                if isinstance(result, BaseException):
                    raise result
                yield done.task, result
    finally:
        for hurried in busy.values():
            hurried.worker.process.kill()
        for worker in [*idle, *(each.worker for each in busy.values())]:
            worker.end()


@dataclass(frozen=True)
class _Worker:
    process: BaseProcess
    connection: Connection

    def send(self, task: object) -> None:
        with suppress(OSError):  # a dead one is found out by its silence
            self.connection.send(task)

    def death(self) -> str:
        """How the process ended, in words."""
        self.end()
        code = self.process.exitcode or 0
        if code == -signal.SIGKILL:
            return "was killed (SIGKILL, as when memory runs out)"
        if code < 0:
            return f"was killed ({signal.Signals(-code).name})"
        return f"ended with exit code {code}"

    def end(self) -> None:
        """Waits for its end; an idle one ends when nobody is there to send it anything."""
        self.connection.close()
        self.process.join()


@dataclass(frozen=True)
class _Busy(Generic[Task]):
    worker: _Worker
    task: Task
    tries: int
    since_s: float


def _answered(
    busy: dict[Connection, _Busy[Task]], limit_s: float | None, title: Callable[[Task], str]
) -> list[Any]:
    """Waits for the connections of workers that are done, or dead.

    Raises:
        WorkerError: One is not within its time.
    """
    longest = min(busy.values(), key=lambda each: each.since_s)
    left = None if limit_s is None else max(0.0, longest.since_s + limit_s - time.monotonic())
    ready = wait(busy, left)
    if not ready:
        raise WorkerError(f"{title(longest.task)} took longer than {limit_s:g} s")
    return ready


def _start(work: Callable[[Any], Any]) -> _Worker:
    os.environ |= dict.fromkeys(THREADS, "1")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(work, theirs))
    process.start()
    theirs.close()  # so that ours ends when the worker does
    return _Worker(process, ours)


def _serve(work: Callable[[Any], Any], connection: Connection) -> None:
    """A worker's life, which ends when the parent says so and not by a signal to all alike."""
    start_worker()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        try:
            result = work(task)
        except CharmsBenchError as error:
            result = error
        except Exception:  # not every exception can be sent
            result = RuntimeError(f"in a worker process:\n{traceback.format_exc()}")
        connection.send(result)


def start_worker() -> None:
    """Leaves Ctrl-C to the parent, and ends the worker when the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def use_exact_maths() -> None:
    """Has NumPy in processes started from now on compute as the compiled engine does.

    Its vectorised tan, arcsin, arctan, exp and power differ from the C library's in the last bit,
    and where there is AVX-512 its OpenBLAS rounds a dot product once instead of twice; so would
    highway-env's vehicles differ from the compiled ones.
    """
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]
    os.environ["NPY_DISABLE_CPU_FEATURES"] = " ".join(extensions.get("found", ()))
    if platform.machine() in ("x86_64", "AMD64"):
        os.environ["OPENBLAS_CORETYPE"] = "Nehalem"  # which has no fused multiply-add
