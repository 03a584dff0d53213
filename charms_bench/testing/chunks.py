"""Compares episodes with highway-env in processes, a few episodes at a time."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from charms_bench.engine.exact_maths import use_exact_maths, worker_environment
from charms_bench.foundation.workers import in_processes

Case = TypeVar("Case")
Found = TypeVar("Found")


def in_chunks(
    compare: Callable[[Case, range], Found],
    cases: Sequence[Case],
    seeds: range,
    size: int,
    title: Callable[[Case], str],
    workers: int | None,
    progress: Callable[[int], None],
    environments: bool = False,
) -> list[list[Found]]:
    """What `compare` finds in each case's episodes of these seeds, in chunks of this size.

    highway-env computes with the functions of `charms_bench.foundation.maths`; see
    `exact_maths.use_exact_maths`. `progress` is called with the number of episodes compared since
    the last call.
    """
    parts = [seeds[k : k + size] for k in range(0, len(seeds), size)]
    chunks = [(index, part) for index in range(len(cases)) for part in parts]

    def titled(chunk: tuple[int, range]) -> str:
        return f"{title(cases[chunk[0]])}, episodes {chunk[1][0]} to {chunk[1][-1]}"

    work = partial(_compared, compare, cases, environments)
    count = min(workers or os.cpu_count() or 1, len(chunks))
    environment = worker_environment("highway-env")
    results: list[list[Found]] = [[] for _ in cases]
    for (index, part), found in in_processes(work, chunks, count, titled, environment=environment):
        results[index].append(found)
        progress(len(part))
    return results


def _compared(
    compare: Callable[[Case, range], Found],
    cases: Sequence[Case],
    environments: bool,
    chunk: tuple[int, range],
) -> Found:
    use_exact_maths("highway-env", environments)
    return compare(cases[chunk[0]], chunk[1])
