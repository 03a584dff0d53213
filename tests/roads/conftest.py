"""A process in which highway-env computes with this project's mathematics, for tests of roads."""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from charms_bench.engine.exact_maths import use_exact_maths, worker_environment
from charms_bench.testing.road_parity import Comparison, compare


@pytest.fixture(scope="session")
def process() -> Iterator[ProcessPoolExecutor]:
    """The process, as `road_parity.verify_road` starts one."""
    maths = ("highway-env", True)
    with ProcessPoolExecutor(1, get_context("spawn"), use_exact_maths, maths) as pool:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in worker_environment("highway-env").items():
                patch.setenv(name, value)
            pool.submit(int).result()
        yield pool


@pytest.fixture(scope="session")
def compared(process: ProcessPoolExecutor) -> Callable[..., Comparison]:
    """`road_parity.compare` in the process."""
    return lambda *args, **options: process.submit(compare, *args, **options).result()
