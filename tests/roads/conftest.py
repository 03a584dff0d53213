"""A process in which highway-env computes with this project's mathematics, for tests of roads."""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from charms_bench.testing.exact_maths import use_exact_maths, worker_environment
from charms_bench.testing.parity import Comparison, compare
from charms_bench.testing.road_parity import RoadCase


@pytest.fixture(scope="session")
def process() -> Iterator[ProcessPoolExecutor]:
    """The process, as `parity.verify` starts one."""
    with ProcessPoolExecutor(1, get_context("spawn"), use_exact_maths) as pool:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in worker_environment().items():
                patch.setenv(name, value)
            pool.submit(int).result()
        yield pool


@pytest.fixture(scope="session")
def compared(process: ProcessPoolExecutor) -> Callable[..., Comparison]:
    """`parity.compare` in the process, of highway-env's road of a name with a configuration."""
    return lambda name, seeds, **configuration: process.submit(
        compare, RoadCase(name, configuration), seeds
    ).result()
