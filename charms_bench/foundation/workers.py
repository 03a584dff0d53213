"""Worker processes on this machine; a worker that dies or hangs costs only its task.

Runs, trainings, `verify`, `rare` and `bench` use `Pool`, and networks are tried with `ask`. Each
worker has a connection of its own, and each answer bears the number of its task. So a worker can be
killed at any moment without a lock that it leaves behind, and no answer is taken for that of
another task, even if a plugin copies its process with `fork`.
"""

import atexit
import gc
import itertools
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import MappingProxyType, ModuleType
from typing import Any, Generic, Self, TypeVar

from charms_bench.errors import AgentError, CharmsBenchError, WorkerError, raised
from charms_bench.foundation.streams import write_to_stderr_only
from charms_bench.foundation.threads import ONE_THREAD

Task = TypeVar("Task")
Result = TypeVar("Result")

TRIES = 3
"""Workers that may die at one task before the task is given up."""
LOOK_S = 1.0
"""How often workers are looked at: a copy of a dead worker can keep its connection open."""
_SAFE_PATH = {"PYTHONSAFEPATH": "1"}
"""Otherwise, a new Python process imports modules from the current folder first."""
FOR_PARENT = (signal.SIGINT, signal.SIGTERM)
"""Signals that the terminal or the system sends to a group of processes; workers ignore them."""
Failed = Callable[[Task, CharmsBenchError], Collection[Task]]
"""Called with a task and its error; returns the tasks that are not to be started any more."""
_numbers = itertools.count(1)
"""The numbers of tasks; no two tasks of this process have the same number."""


def in_processes(
    work: Callable[[Task], Result],
    tasks: Iterable[Task],
    count: int,
    title: Callable[[Task], str] = str,
    limit_s: float | None = None,
    notice: Callable[[str], None] = lambda what: None,
    environment: Mapping[str, str] = MappingProxyType({}),
    failed: "Failed[Task] | None" = None,
) -> Generator[tuple[Task, Result], None, None]:
    """As `Pool`: yields each task with its result. Closing the generator ends the workers."""
    with Pool(work, count, title, limit_s, notice, environment, failed=failed) as pool:
        pool.add(tasks)
        yield from pool.results()


class Pool(Generic[Task, Result]):
    """Workers that answer tasks; leaving the context ends them at once.

    A worker that dies is replaced, and its task is given to another worker.

    Args:
        work: A function of a task; it and the tasks are pickled. Each worker gets it once, so it
            may keep something between tasks.
        title: Returns what messages call a task.
        limit_s: Seconds that a task may take, including the start of its worker.
        notice: Called with a message when a worker has died.
        environment: Environment variables that the processes are started with, besides ours.
        told: Called with what `tell` is given in a worker.
        failed: Called with a task that failed; by default, `results` raises its error.
        tries: Workers that may die at one task before the task is given up.
    """

    def __init__(
        self,
        work: Callable[[Task], Result],
        count: int,
        title: Callable[[Task], str] = str,
        limit_s: float | None = None,
        notice: Callable[[str], None] = lambda what: None,
        environment: Mapping[str, str] = MappingProxyType({}),
        told: Callable[[Any], None] = lambda what: None,
        failed: Failed[Task] | None = None,
        tries: int = TRIES,
    ) -> None:
        self._work, self._count, self._title, self._limit_s = work, count, title, limit_s
        self._notice, self._environment, self._told = notice, environment, told
        self._failed, self._tries = failed, tries
        self._waiting: deque[tuple[Task, int]] = deque()
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, _Busy[Task]] = {}
        self._is_stopped = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in [*self._idle, *(each.worker for each in self._busy.values())]:
            worker.kill()  # an idle worker would take a while to end on its own

    def add(self, tasks: Iterable[Task]) -> None:
        """Adds tasks, which `results` hands out; as many at once as there are processes."""
        self._waiting += ((task, 1) for task in tasks)

    def results(self, wait_s: float | None = None) -> Iterator[tuple[Task, Result]]:
        """Yields tasks with their results, until none is left or `wait_s` seconds are over.

        Raises:
            Died: `tries` workers died at a task, or it took longer than the limit.
            CharmsBenchError: `work` raised it.
        """
        until = None if wait_s is None else time.monotonic() + wait_s
        while self._waiting or self._busy:
            self._hand_out()
            for connection in self._ready(until):
                if (answered := self._receive(connection)) is None:
                    continue
                task, result = answered
                if isinstance(result, BaseException):
                    if self._is_stopped:
                        continue
                    if self._failed is None or not isinstance(result, CharmsBenchError):
                        raise result
                    dropped = self._failed(task, result)
                    kept = (each for each in self._waiting if each[0] not in dropped)
                    self._waiting = deque(kept)
                    continue
                self._hand_out()  # the worker goes on while the caller uses the result
                yield task, result
            if until is not None and time.monotonic() >= until:
                return

    def stop(self) -> None:
        """Drops the tasks that wait, and has `stop_requested` return True in busy workers.

        From now on, `results` ignores errors.
        """
        self._is_stopped = True
        self._waiting.clear()
        for each in self._busy.values():
            each.worker.send(None)

    def _hand_out(self) -> None:
        while self._waiting and len(self._busy) < self._count:
            worker = self._idle.pop() if self._idle else _worker_for(self._work, self._environment)
            task, tries = self._waiting.popleft()
            number = next(_numbers)
            self._busy[worker.connection] = _Busy(worker, task, tries, number, time.monotonic())
            worker.send((number, task))

    def _ready(self, until: float | None) -> list[Connection]:
        """Waits until workers answer or die; returns their connections."""
        while True:
            now = time.monotonic()
            longest = min(self._busy.values(), key=lambda each: each.since_s)
            left = LOOK_S if until is None else min(LOOK_S, until - now)
            if self._limit_s is not None:
                left = min(left, longest.since_s + self._limit_s - now)
            ready = wait(self._busy, max(0.0, left))
            if ready := ready or [c for c, each in self._busy.items() if each.worker.is_dead()]:
                return ready  # type: ignore[return-value]  # `wait` takes other things, too
            now = time.monotonic()
            if self._limit_s is not None and now >= longest.since_s + self._limit_s:
                longest.worker.process.kill()
                return [longest.worker.connection]
            if until is not None and now >= until:
                return []

    def _receive(self, connection: Connection) -> tuple[Task, Result | BaseException] | None:
        """Receives an answer, or has a task done again whose worker has died."""
        done = self._busy[connection]
        try:
            if not connection.poll():
                raise EOFError
            number, is_answer, result = connection.recv()
        except Exception:  # what is cut off, or written by two processes at once, can raise any
            del self._busy[connection]
            if self._is_stopped:
                done.worker.kill()
                return None
            title, death = self._title(done.task), done.worker.death()
            if self._limit_s is not None and time.monotonic() >= done.since_s + self._limit_s:
                return done.task, Died(None, f"{title} took longer than {self._limit_s:g} s")
            what = f"a worker process {death} at {title}"
            if done.tries == self._tries:
                what += f", and so did {self._tries - 1} before it" * (self._tries > 1)
                return done.task, Died(done.worker.process.exitcode, what)
            self._notice(f"{what}; another worker takes its place")
            self._waiting.appendleft((done.task, done.tries + 1))
            return None
        if number != done.number:
            return None  # a copy of the worker's process has answered an earlier task again
        if not is_answer:
            self._told(result)
            return None
        del self._busy[connection]
        if isinstance(result, BaseException):
            done.worker.kill()  # a plugin that fails may have changed its process
        else:
            self._idle.append(done.worker)
        return done.task, result


class Died(WorkerError):
    """A task was given up, because its workers died, or because it took too long.

    `signal` is what killed the last worker; None if it ended by itself or took too long.
    """

    def __init__(self, exit_code: int | None, what: str = "") -> None:
        super().__init__(what)
        self.signal = (
            signal.Signals(-exit_code) if exit_code is not None and exit_code < 0 else None
        )
        self.took_too_long = exit_code is None


def ask(work: Callable[[Task], Result], task: Task, limit_s: float) -> Result:
    """Runs one task in a worker within `limit_s`, including its start; keeps the worker.

    The function, the task and the result are pickled.

    Raises:
        Died: The worker died, or took longer.
        CharmsBenchError: `work` raised it.
    """
    options: dict[str, Any] = {"limit_s": limit_s, "environment": ONE_THREAD, "tries": 1}
    with _asking, Pool(work, 1, lambda task: work.__name__, **options) as pool:
        pool.add([task])
        ((_, result),) = pool.results()
        _spare.append(pool._idle.pop())
    return result


@dataclass(frozen=True)
class _Worker:
    process: BaseProcess
    connection: Connection

    def send(self, what: object) -> None:
        """Sends the function to work with, a task with its number, or None: to stop."""
        with suppress(OSError):  # a dead worker is noticed when its connection ends
            self.connection.send(what)

    def is_dead(self) -> bool:
        """Whether the process has ended, and everything that it sent has been received."""
        return self.process.exitcode is not None and not self.connection.poll()

    def death(self) -> str:
        """Ends the process, if it has not ended by itself, and returns in words how it did."""
        self.process.join(LOOK_S)
        self.kill()
        code = self.process.exitcode or 0
        if code == -signal.SIGKILL:
            return "was killed (SIGKILL, as when memory runs out)"
        if code < 0:
            return f"was killed ({signal.Signals(-code).name})"
        return f"ended with exit code {code}"

    def kill(self) -> None:
        """Kills the process and waits for its end."""
        self.process.kill()  # first: a worker that loses its connection would complain
        self.process.join()
        self.connection.close()


@dataclass(frozen=True)
class _Busy(Generic[Task]):
    worker: _Worker
    task: Task
    tries: int
    number: int
    since_s: float


_spare: list[_Worker] = []
"""Workers that have nothing to do: those started early, and the one that `ask` keeps."""
_asking = threading.Lock()


def _end_spare() -> None:
    while _spare:
        _spare.pop().kill()


os.register_at_fork(after_in_child=_spare.clear)
atexit.register(_end_spare)  # before multiprocessing, which would wait for them


@contextmanager
def started_early(count: int, module: str) -> Iterator[None]:
    """Starts workers that import a module while this process is busy with something else.

    Within this context, `Pool` uses them if they have the environment that it asks for, and so does
    `ask`.
    """
    _spare.extend(_start(ONE_THREAD, module) for _ in range(count))
    try:
        yield
    finally:
        _end_spare()


def _worker_for(work: Callable[[Any], Any], environment: Mapping[str, str]) -> _Worker:
    worker = _spare.pop() if _spare and environment == ONE_THREAD else _start(environment)
    worker.send(work)
    return worker


def _start(environment: Mapping[str, str], module: str = __name__) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, module))
    with _starting({**environment, **_SAFE_PATH}):
        process.start()
    theirs.close()  # so that our end reports the death of the worker
    return _Worker(process, ours)


@contextmanager
def _starting(environment: Mapping[str, str]) -> Iterator[None]:
    """Lets processes that are started within have these environment variables, and no main module.

    Otherwise a new process would import the user's script again, and a script that starts a run
    would start it again. Signals wait until a new process ignores them.
    """
    main = sys.modules["__main__"]
    before = {name: os.environ.get(name) for name in environment}
    sys.modules["__main__"] = ModuleType("__main__")
    os.environ |= environment
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, FOR_PARENT)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        sys.modules["__main__"] = main
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@dataclass
class _Served:
    """The task that this worker is busy with."""

    connection: Connection
    number: int
    is_stopped: bool = False


_TASKS_PER_COLLECTION = 16
_served: list[_Served] = []
"""Only in a worker."""


def is_child() -> bool:
    """Returns whether another process has started this one and can end it."""
    return multiprocessing.parent_process() is not None


def tell(what: object) -> None:
    """Tells the parent something about the task; see `Pool`."""
    for served in _served:
        served.connection.send((served.number, False, what))


def stop_requested() -> bool:
    """Returns whether the parent has asked this worker to stop; see `Pool.stop`."""
    for served in _served:
        if not served.is_stopped and served.connection.poll():
            served.is_stopped = served.connection.recv() is None
    return any(served.is_stopped for served in _served)


def _serve(connection: Connection, module: str) -> None:
    """Receives a function, and answers tasks with it until the parent closes the connection.

    `module` is imported at once, because the function may come later.
    """
    gc.set_threshold(100_000)  # else a quarter of the start is spent on collecting live objects
    threading.Thread(target=_end_with_parent, daemon=True).start()
    write_to_stderr_only()  # standard output is for results, whatever a plugin prints
    for number in FOR_PARENT:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, FOR_PARENT)
    process = os.getpid()
    os.register_at_fork(after_in_child=connection.close)
    import_module(module)
    work: Callable[[Any], Any] | None = None
    answered = itertools.count(1)
    with suppress(EOFError, OSError):  # the parent has closed the connection
        while True:
            received = connection.recv()
            if callable(received):
                work = received
            if not isinstance(received, tuple):
                continue  # a request to stop that came after the answer
            number, task = received
            assert work is not None
            _served[:] = [_Served(connection, number)]
            answer = _answer(work, task)
            if os.getpid() != process:
                os._exit(0)  # a copy of this process, made by a plugin
            connection.send((number, True, answer))
            # What tasks leave in cycles, such as a simulation, can be large, and has few objects.
            count = next(answered)
            if count % _TASKS_PER_COLLECTION == 0:
                gc.collect()
            if count == 1 or count % _TASKS_PER_COLLECTION == 0:
                gc.freeze()  # else each collection would look at all that has been imported


def _answer(work: Callable[[Any], Any], task: object) -> object:
    """The result of a task, or the error that it raised."""
    try:
        return work(task)
    except CharmsBenchError as error:
        return error
    except (OSError, MemoryError) as error:
        return WorkerError(f"in a worker process: {raised(error)}")
    except Exception:  # not every exception can be pickled
        return RuntimeError(f"in a worker process:\n{traceback.format_exc()}")
    except BaseException as error:  # no signal of ours raises one here
        return AgentError(f"a plugin or a library {raised(error)}")


def _end_with_parent() -> None:
    """Waits for the end of the parent, and then ends this process."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
