"""Worker processes that die, hang or raise an error."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from charms_bench.errors import AgentError, WorkerError
from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.foundation.workers import (
    Died,
    Pool,
    _starting,
    ask,
    in_processes,
    started_early,
    stop_requested,
    tell,
)


def doubled(number: int) -> int:
    return 2 * number


def dies(places: Path, times: int, number: int) -> int:
    """Kills its process the first times that it is asked about 3."""
    tried = places / f"{len(list(places.iterdir()))}"
    if number == 3 and int(tried.name) < times:
        tried.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def hangs(number: int) -> int:
    while number == 3:
        time.sleep(1)
    return 2 * number


def blames_its_agent(number: int) -> int:
    raise AgentError("agent 'it' did it")


def has_a_bug(number: int) -> int:
    return number // 0


def test_every_task_comes_back_with_its_result() -> None:
    assert sorted(in_processes(doubled, range(5), 2)) == [(i, 2 * i) for i in range(5)]


def threads(number: int) -> tuple[int, str]:
    return os.getpid(), os.environ["NUMBA_NUM_THREADS"]


def test_workers_that_were_started_early_take_the_tasks() -> None:
    others = {child.pid for child in multiprocessing.active_children()}
    with started_early(2, "json"):
        early = {child.pid for child in multiprocessing.active_children()} - others
        assert len(early) == 2
        found = dict(in_processes(threads, range(6), 2, environment=ONE_THREAD))
        assert {pid for pid, _ in found.values()} <= early
    assert not early & {child.pid for child in multiprocessing.active_children()}


def test_workers_with_another_environment_are_not_those_that_were_started_early() -> None:
    others = {child.pid for child in multiprocessing.active_children()}
    with started_early(1, "json"):
        (early,) = (child for child in multiprocessing.active_children() if child.pid not in others)
        environment = {**ONE_THREAD, "NUMBA_NUM_THREADS": "2"}
        ((_, found),) = in_processes(threads, [1], 1, environment=environment)
        assert found[0] != early.pid
        assert found[1] == "2"
    assert not early.is_alive()


def test_a_worker_that_dies_is_replaced_and_said_so(tmp_path: Path) -> None:
    notices: list[str] = []
    work = partial(dies, tmp_path, 2)
    found = sorted(in_processes(work, range(5), 2, "number {}".format, notice=notices.append))
    assert found == [(i, 2 * i) for i in range(5)]
    assert len(notices) == 2
    assert "was killed (SIGKILL, as when memory runs out) at number 3; another" in notices[0]


def test_a_task_that_costs_every_worker_is_given_up_by_name(tmp_path: Path) -> None:
    with pytest.raises(WorkerError, match="at number 3, and so did 2 before it"):
        list(in_processes(partial(dies, tmp_path, 9), [3, 4], 1, "number {}".format))
    assert len(list(tmp_path.iterdir())) == 3


def test_what_was_finished_before_a_task_hangs_has_come_back() -> None:
    results = in_processes(hangs, [1, 2, 3], 1, "number {}".format, limit_s=5.0)
    assert [next(results), next(results)] == [(1, 2), (2, 4)]
    with pytest.raises(WorkerError, match="number 3 took longer than 5 s"):
        next(results)


def test_variables_of_a_worker_are_taken_back_and_all_others_are_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with _starting({"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}):
        assert os.environ["OMP_NUM_THREADS"] == os.environ["NUMBA_NUM_THREADS"] == "1"
        monkeypatch.setenv("SET_BY_ANOTHER_THREAD", "yes")
    assert os.environ["OMP_NUM_THREADS"] == "8"
    assert "NUMBA_NUM_THREADS" not in os.environ
    assert os.environ["SET_BY_ANOTHER_THREAD"] == "yes"


def test_an_error_of_ours_keeps_its_message() -> None:
    with pytest.raises(AgentError, match="agent 'it' did it"):
        list(in_processes(blames_its_agent, [1], 1))


def test_a_bug_in_a_worker_shows_where_it_is() -> None:
    with pytest.raises(RuntimeError, match=r"in has_a_bug\n.*number // 0(.*\n)*ZeroDivisionError"):
        list(in_processes(has_a_bug, [1], 1))


def test_closing_ends_workers_that_are_busy() -> None:
    with closing(in_processes(hangs, [1, 3, 3], 2)) as results:
        next(results)  # and not three hours later, when a task of 3 would be done


class InACycle:
    def __init__(self) -> None:
        self.itself = self


def left_of(number: int, made: list[weakref.ref[InACycle]] = []) -> int:  # noqa: B006
    """How many of the cycles that earlier tasks made, all but the first, are still there."""
    left = sum(cycle() is not None for cycle in made[1:])
    made.append(weakref.ref(InACycle()))
    return left


def test_what_tasks_leave_in_cycles_is_gone_some_tasks_later() -> None:
    assert max(left for _, left in in_processes(left_of, range(40), 1)) <= 16


def fork_in_c() -> int:
    """Copies the process without Python's knowledge."""
    return int(ctypes.CDLL(None).fork())


def is_copied(fork: Callable[[], int], number: int) -> int:
    """Copies its process once; the copy goes on with the task, and answers later."""
    if number == 1 and fork() == 0:
        time.sleep(0.5)
        return -1
    time.sleep(0.2)
    return number


@pytest.mark.parametrize("fork", [os.fork, fork_in_c])
def test_a_copy_of_a_worker_answers_nothing(fork: Callable[[], int]) -> None:
    found = list(in_processes(partial(is_copied, fork), range(1, 7), 1))
    assert found == [(number, number) for number in range(1, 7)]


def dies_and_leaves_a_copy(number: int) -> int:
    if fork_in_c() == 0:
        time.sleep(15)
        os._exit(0)
    os._exit(7)


def test_a_worker_is_dead_even_if_a_copy_keeps_its_connection_open() -> None:
    start = time.monotonic()
    with pytest.raises(WorkerError, match="ended with exit code 7 at 1, and so did 2 before it"):
        list(in_processes(dies_and_leaves_a_copy, [1], 1))
    assert time.monotonic() - start < 15  # else each worker lasts as long as its copy


def waits_for_the_end(number: int) -> str:
    tell(f"{number} has begun")
    while not stop_requested():
        time.sleep(0.01)
    return "stopped"


def test_workers_tell_their_parent_and_stop_when_they_are_asked_to() -> None:
    told: list[str] = []
    with Pool(waits_for_the_end, 2, told=told.append) as pool:
        pool.add([1, 2, 3])
        while len(told) < 2:
            assert list(pool.results(0.1)) == []
        pool.stop()
        assert sorted(pool.results()) == [(1, "stopped"), (2, "stopped")]
    assert sorted(told) == ["1 has begun", "2 has begun"]


def test_each_process_of_a_pool_gets_one_of_as_many_tasks() -> None:
    with Pool(threads, 3, environment=ONE_THREAD) as pool:
        for _ in range(3):
            pool.add(range(3))
            assert len({pid for _, (pid, _) in pool.results()}) == 3


def ends_by(signal_number: int) -> int:
    signal.signal(signal_number, signal.SIG_DFL)
    os.kill(os.getpid(), signal_number)
    return 0


def test_a_worker_that_is_asked_is_kept_until_it_dies() -> None:
    pid, _ = ask(threads, 1, 60.0)
    assert ask(threads, 2, 60.0)[0] == pid
    with pytest.raises(Died) as died:
        ask(ends_by, signal.SIGFPE, 60.0)
    assert died.value.signal == signal.SIGFPE
    with pytest.raises(Died) as died:
        ask(hangs, 3, 5.0)
    assert died.value.took_too_long
    with pytest.raises(AgentError, match="agent 'it' did it"):
        ask(blames_its_agent, 1, 60.0)
    assert ask(threads, 2, 60.0)[0] != pid


USES_WORKERS = """\
from charms_bench.foundation.workers import in_processes
if __name__ == "__main__":
    assert list(in_processes(abs, [-1], 1)) == [(-1, 1)]
"""


def test_workers_import_nothing_from_the_current_folder(tmp_path: Path) -> None:
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts" / "script.py").write_text(USES_WORKERS)
    for module in ("pickle", "signal", "multiprocessing", "socket", "runpy"):
        (tmp_path / f"{module}.py").write_text("raise SystemExit('code of the current folder')")
    command = [sys.executable, tmp_path / "scripts" / "script.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
