"""Worker processes that die, hang or raise an error."""

import multiprocessing
import os
import signal
import time
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from charms_bench.errors import AgentError, WorkerError
from charms_bench.workers import _starting, in_processes, started_early
from charms_bench.world.threads import ONE_THREAD


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
    with started_early(2, "json"):
        early = {child.pid for child in multiprocessing.active_children()}
        assert len(early) == 2
        found = dict(in_processes(threads, range(6), 2, environment=ONE_THREAD))
        assert {pid for pid, _ in found.values()} <= early
    assert not early & {child.pid for child in multiprocessing.active_children()}


def test_workers_with_another_environment_are_not_those_that_were_started_early() -> None:
    with started_early(1, "json"):
        (early,) = multiprocessing.active_children()
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
