"""Compares this project's engines with highway-env itself, after every step of an episode."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import process_time
from typing import Any, Protocol

import numpy as np

from charms_bench.foundation.workers import in_processes
from charms_bench.testing.exact_maths import TOLERANCE, use_exact_maths, worker_environment
from charms_bench.testing.stock_roads import unchanged_idm

Values = dict[str, tuple[Any, Any]]
"""Our value and highway-env's, by what they are of."""
_CHUNK = 5


class Episode(Protocol):
    """An episode that is driven twice, by charms-bench and by highway-env."""

    step_name: str
    """What both advance by, such as a simulation step."""

    def start(self, seed: int) -> None:
        """Starts the episode of a seed in both."""

    def advance(self) -> None:
        """Advances that of charms-bench by a step."""

    def advance_stock(self) -> None:
        """Advances highway-env's by the same step."""

    def values(self) -> Values:
        """What is compared now."""

    def is_over(self) -> bool:
        """Whether nothing is left to compare."""

    def has_crashed(self) -> bool:
        """Whether an ego has crashed."""


class Case(Protocol):
    """A road with those who drive on it."""

    @property
    def title(self) -> str:
        """A description in one line."""

    def episode(self) -> Episode:
        """An episode, not yet started."""


@dataclass
class Comparison:
    """What the comparison of some episodes of a case found."""

    case: str
    episodes: int = 0
    steps: int = 0
    """Simulation steps on the straight road, decisions on highway-env's others, seconds on maps."""
    crashed: int = 0
    """Episodes in which an ego crashed."""
    largest: float = 0.0
    """The largest difference of a number."""
    largest_at_start: float = 0.0
    """The same, of the starts of episodes alone."""
    own_s: float = 0.0
    """The CPU time of charms-bench for the steps, s."""
    stock_s: float = 0.0
    """The same of highway-env."""
    differences: list[str] = field(default_factory=list)
    """The first difference of each episode that has one above the tolerance."""

    def __add__(self, other: "Comparison") -> "Comparison":
        largest = {
            name: max(getattr(self, name), getattr(other, name))
            for name in ("largest", "largest_at_start")
        }
        added = ("episodes", "steps", "crashed", "own_s", "stock_s", "differences")
        sums = {name: getattr(self, name) + getattr(other, name) for name in added}
        return Comparison(self.case, **largest, **sums)


def verify(
    cases: Sequence[Case],
    seeds: range,
    workers: int | None = None,
    progress: Callable[[int], None] = lambda episodes: None,
    steps: float = np.inf,
) -> list[Comparison]:
    """Compares the episodes of these seeds of each case, in processes with exact maths.

    At most `steps` steps of an episode are compared; with 0, only its start. `progress` is called
    with the number of episodes compared since the last call.
    """
    parts = [seeds[k : k + _CHUNK] for k in range(0, len(seeds), _CHUNK)]
    chunks = [(index, part) for index in range(len(cases)) for part in parts]

    def titled(chunk: tuple[int, range]) -> str:
        return f"{cases[chunk[0]].title}, episodes {chunk[1][0]} to {chunk[1][-1]}"

    work = partial(_compared, cases, steps)
    count = min(workers or os.cpu_count() or 1, len(chunks))
    results = [Comparison(case.title) for case in cases]
    for (index, part), found in in_processes(
        work, chunks, count, titled, environment=worker_environment()
    ):
        results[index] += found
        progress(len(part))
    return results


def _compared(cases: Sequence[Case], steps: float, chunk: tuple[int, range]) -> Comparison:
    use_exact_maths()
    return compare(cases[chunk[0]], chunk[1], steps)


@unchanged_idm()
def compare(
    case: Case, seeds: range, steps: float = np.inf, tolerance: float = TOLERANCE
) -> Comparison:
    """Compares the episodes of these seeds with highway-env as it computes in this process."""
    episode, found = case.episode(), Comparison(case.title)
    for seed in seeds:
        episode.start(seed)
        apart, what = largest(episode.values())
        found.largest_at_start = max(found.largest_at_start, apart)
        found.episodes += 1
        step = 0
        while apart <= tolerance and step < steps and not episode.is_over():
            began = process_time()
            episode.advance()
            between = process_time()
            episode.advance_stock()
            found.own_s += between - began
            found.stock_s += process_time() - between
            step += 1
            apart, what = largest(episode.values())
            found.largest = max(found.largest, apart)
        found.largest = max(found.largest, found.largest_at_start)
        found.steps += step
        found.crashed += episode.has_crashed()
        if apart > tolerance:
            found.differences.append(f"episode {seed}, {episode.step_name} {step}: {what}")
    return found


def largest(values: Values) -> tuple[float, str]:
    """The largest difference of two values, and what it is of."""
    apart = {what: differences(*pair) for what, pair in values.items()}
    what = max(apart, key=lambda name: apart[name].max(initial=0.0))
    if not apart[what].size:
        return 0.0, ""
    ours, theirs = values[what]
    most, where = float(apart[what].max()), what
    if np.shape(ours) == apart[what].shape != ():
        at = np.unravel_index(int(apart[what].argmax()), apart[what].shape)
        where += f"[{', '.join(map(str, at))}]"
        ours, theirs = np.asarray(ours)[at], np.asarray(theirs)[at]
    return most, f"{where}: {ours!r} (charms-bench), {theirs!r} (highway-env)"


def differences(ours: Any, theirs: Any) -> np.ndarray:
    """The differences of numbers in arrays of the same shape; infinite for other shapes."""
    one, other = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    if one.shape != other.shape:
        return np.array(np.inf)
    is_same = (one == other) | (np.isnan(one) & np.isnan(other))  # infinities, too
    with np.errstate(invalid="ignore"):
        apart = np.where(is_same, 0.0, np.abs(one - other))
    return np.nan_to_num(apart, nan=np.inf, posinf=np.inf)
