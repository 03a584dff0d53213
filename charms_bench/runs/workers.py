"""Worker processes on this machine; a worker that dies or hangs costs only its task."""

import gc
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import MappingProxyType, ModuleType
from typing import Any, Generic, TypeVar

from charms_bench.errors import AgentError, CharmsBenchError, WorkerError, raised
from charms_bench.world.threads import ONE_THREAD

Task = TypeVar("Task")
Result = TypeVar("Result")

TRIES = 3
"""Workers that may die at one task before the task is given up."""


def in_processes(
    work: Callable[[Task], Result],
    tasks: Iterable[Task],
    count: int,
    title: Callable[[Task], str] = str,
    limit_s: float | None = None,
    notice: Callable[[str], None] = lambda what: None,
    environment: Mapping[str, str] = MappingProxyType({}),
) -> Generator[tuple[Task, Result], None, None]:
    """Yields each task with its result as soon as it is finished.

    Closing the generator ends the workers at once. A worker that dies is replaced, and its task
    is given to another worker.

    Args:
        work: A function of a task; it and the tasks are pickled.
        tasks: What to do.
        count: Number of processes.
        title: Returns what messages call a task.
        limit_s: Seconds that a task may take, including the start of its worker.
        notice: Called with a message when a worker has died.
        environment: Environment variables that the processes are started with, besides ours.

    Raises:
        WorkerError: `TRIES` workers died at a task, or it took longer than `limit_s`.
        CharmsBenchError: `work` raised it.
    """
    waiting = deque((task, 1) for task in tasks)
    idle: list[_Worker] = []
    busy: dict[Connection, _Busy[Task]] = {}

    def hand_out() -> None:
        while waiting and len(busy) < count:
            worker = idle.pop() if idle else _worker_for(work, environment)
            task, tries = waiting.popleft()
            busy[worker.connection] = _Busy(worker, task, tries, time.monotonic())
            worker.send(task)

    try:
        while waiting or busy:
            hand_out()
            for connection in _answered(busy, limit_s, title):
                done = busy.pop(connection)
                try:
                    result = connection.recv()
                except (EOFError, OSError):
                    how = done.worker.death()
                    what = f"a worker process {how} at {title(done.task)}"
                    if done.tries == TRIES:
                        raise WorkerError(f"{what}, and so did {TRIES - 1} before it") from None
                    notice(f"{what}; another worker takes its place")
                    waiting.appendleft((done.task, done.tries + 1))
                    continue
                idle.append(done.worker)
                if isinstance(result, BaseException):
                    raise result
                hand_out()  # the worker goes on while the caller uses the result
                yield done.task, result
    finally:
        for worker in [*idle, *(each.worker for each in busy.values())]:
            worker.process.kill()  # an idle worker would take a while to end on its own
            worker.end()


@dataclass(frozen=True)
class _Worker:
    process: BaseProcess
    connection: Connection

    def send(self, task: object) -> None:
        with suppress(OSError):  # a dead worker is noticed when its connection ends
            self.connection.send(task)

    def death(self) -> str:
        """Waits for the process to end and returns in words how it did."""
        self.end()
        code = self.process.exitcode or 0
        if code == -signal.SIGKILL:
            return "was killed (SIGKILL, as when memory runs out)"
        if code < 0:
            return f"was killed ({signal.Signals(-code).name})"
        return f"ended with exit code {code}"

    def end(self) -> None:
        """Waits for the process to end."""
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
    """Waits until workers answer or die, and returns their connections.

    Raises:
        WorkerError: The longest-running task has used up its time.
    """
    longest = min(busy.values(), key=lambda each: each.since_s)
    left = None if limit_s is None else max(0.0, longest.since_s + limit_s - time.monotonic())
    ready = wait(busy, left)
    if not ready:
        raise WorkerError(f"{title(longest.task)} took longer than {limit_s:g} s")
    return ready


_early: list[_Worker] = []
"""Workers that have been started early and have nothing to do yet."""


@contextmanager
def started_early(count: int, module: str) -> Iterator[None]:
    """Starts workers that import a module while this process is busy with something else.

    Within this context, `in_processes` uses them if they have the environment that it asks for.
    """
    _early[:] = [_start(ONE_THREAD, module) for _ in range(count)]
    try:
        yield
    finally:
        while _early:
            _early[-1].process.kill()
            _early.pop().end()


def _worker_for(work: Callable[[Any], Any], environment: Mapping[str, str]) -> _Worker:
    worker = _early.pop() if _early and environment == ONE_THREAD else _start(environment)
    worker.send(work)
    return worker


def _start(environment: Mapping[str, str], module: str = __name__) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, module))
    with starting(environment):
        process.start()
    theirs.close()  # so that our end reports the death of the worker
    return _Worker(process, ours)


@contextmanager
def starting(environment: Mapping[str, str]) -> Iterator[None]:
    """Lets processes that are started within have these environment variables, and no main module.

    Otherwise a new process would import the user's script again, and a script that starts a run
    would start it again.
    """
    main = sys.modules["__main__"]
    before = {name: os.environ.get(name) for name in environment}
    sys.modules["__main__"] = ModuleType("__main__")
    os.environ |= environment
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _serve(connection: Connection, module: str) -> None:
    """Receives a function, and answers tasks with it until the parent closes the connection.

    `module` is imported at once, because the function may come later.
    """
    start_worker()
    os.dup2(2, 1)  # standard output is for results, whatever a plugin prints
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a signal to the group is for the parent
    import_module(module)
    with suppress(EOFError):
        work = connection.recv()
        while True:
            connection.send(_answer(work, connection.recv()))


def _answer(work: Callable[[Any], Any], task: object) -> object:
    """The result of a task, or the error that it raised."""
    try:
        return work(task)
    except CharmsBenchError as error:
        return error
    except (SystemExit, KeyboardInterrupt) as error:  # no signal of ours raises these here
        return AgentError(f"a plugin or a library {raised(error)}")
    except Exception:  # not every exception can be pickled
        return RuntimeError(f"in a worker process:\n{traceback.format_exc()}")


def start_worker() -> None:
    """Leaves Ctrl-C to the parent, and ends this process when the parent has ended."""
    gc.set_threshold(100_000)  # else a quarter of the start is spent on collecting live objects
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
