"""What tests share: one thread per library, workers without processes, small networks."""

import os
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

# NumPy, numba and Polars read these once, when they are imported.
for variable in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "POLARS_MAX_THREADS"):
    os.environ.setdefault(variable, "1")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begins with the type checker and its like: at the end, one would leave processes idle."""
    items.sort(key=lambda item: "test_the_project_passes" not in item.name)


@pytest.fixture(scope="session", autouse=True)
def _one_worker_is_this_process() -> Iterator[None]:
    """Runs with `workers=1` simulate in the test process, and no worker starts before it has work.

    Tests of the workers themselves start theirs, and so do commands in processes of their own.
    """
    from charms_bench.errors import CharmsBenchError
    from charms_bench.foundation import workers
    from charms_bench.runs import runner

    in_processes = runner.in_processes

    def here(work: Callable[..., Any], tasks: list[Any], count: int, *others: Any) -> Iterator[Any]:
        if count != 1:
            yield from in_processes(work, tasks, count, *others)
            return
        failed, dropped = others[4], set[Any]()
        for task in tasks:
            try:
                if task not in dropped:
                    yield task, work(task)
            except CharmsBenchError as error:
                if failed is None:
                    raise
                dropped |= failed(task, error)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "in_processes", here)
        patch.setattr(workers, "started_early", lambda *_: nullcontext())
        yield


@pytest.fixture(scope="session", autouse=True)
def _sb3_logs_into_the_folder_of_the_tests(tmp_path_factory: pytest.TempPathFactory) -> None:
    os.environ["SB3_LOGDIR"] = str(tmp_path_factory.mktemp("sb3"))


@pytest.fixture
def network_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes an ONNX file of one linear layer into the test's folder; see `linear_network`."""
    from linear_network import linear_network

    pytest.importorskip("onnx", reason="needs the extra 'train'")
    return lambda *given, name="policy.onnx", **said: linear_network(
        tmp_path / name, *given, **said
    )
