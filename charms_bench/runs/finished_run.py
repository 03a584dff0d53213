"""Finished runs, opened from their folders: the rows of every cell."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.errors import CharmsBenchError, RunFolderError, SuiteError
from charms_bench.runs.cells import CellRows, Rows, TrafficCounts
from charms_bench.runs.resumable_folder import RunFolder
from charms_bench.runs.shard_names import Shard
from charms_bench.runs.shard_rows import problem_of_steps
from charms_bench.runs.suite import Suite

EPISODES_AND_STEPS = ("episodes", "steps")
_NO_SEEDS = pl.Series(dtype=pl.UInt64)
PART_ROWS = 2**18
"""About how many step rows are in memory at once."""


@dataclass(frozen=True)
class FinishedRun:
    """A suite whose shards are in a run folder."""

    suite: Suite
    folder: RunFolder
    shards: tuple[Shard, ...]
    failed: Mapping[int, CharmsBenchError] = field(default_factory=dict)
    """Why cells are not finished, by cell; empty for a run that has been opened."""
    leaves_out: bool = True
    """Whether concrete scenarios are left out in which prescribed vehicles collide with one
    another (`engine.pile_ups`); tables of earlier versions have them."""

    @property
    def finished(self) -> list[int]:
        """The indices of the finished cells."""
        return [index for index in range(len(self.suite.cells)) if index not in self.failed]

    def cells(self) -> list[CellRows]:
        """Returns the rows of every finished cell; see `cell`."""
        return [self.cell(index) for index in self.finished]

    def cell(self, index: int) -> CellRows:
        """Returns the rows of one cell, which are read when they are needed.

        Reading raises a `RunFolderError` if a file is missing or has changed since it was written.
        """
        cell = self.suite.cells[index]
        left_out = self.left_out(index)
        return CellRows(
            agent=cell.ego.title,
            traffic=cell.traffic.title,
            size=self.suite.episodes - len(left_out),
            parts=self._parts(index, *EPISODES_AND_STEPS),
            drivers=self._parts(index, "drivers"),
            paper=cell.paper,
            left_out=len(left_out),
            road=cell.road.title if cell.road else "",
        )

    def left_out(self, index: int) -> pl.Series:
        """The seeds of a cell's episodes that are left out; a `SuiteError` if these are all."""
        suite, cell = self.suite, self.suite.cells[index]
        if not self.leaves_out or cell.scene.scenario is None:
            return _NO_SEEDS
        place = index % len(suite.surroundings)
        if place not in self._left_out:
            from charms_bench.engine.pile_ups import pile_ups  # loads the compiled engine
            from charms_bench.runs.shard import engine_on  # as this does

            seeds = np.arange(suite.seed, suite.seed + suite.episodes)
            found = pile_ups(cell.scene, seeds, engine_on(cell.scene))
            self._left_out[place] = pl.Series(seeds[found], dtype=pl.UInt64)
        if len(self._left_out[place]) == suite.episodes:
            raise SuiteError(
                f"suite '{suite.suite}': {cell.traffic.title}: prescribed vehicles collide with "
                "one another in every concrete scenario; change what they do"
            )
        return self._left_out[place]

    @cached_property
    def _left_out(self) -> dict[int, pl.Series]:
        """The seeds that are left out in each traffic so far; every ego has the same scenarios."""
        return {}

    def following(self) -> list[TrafficCounts]:
        """What the vehicles of every finished cell did while they followed a leader; see `cell`."""
        return [
            TrafficCounts.of(
                self.suite.cells[index].surroundings.title,
                self.suite.episodes - len(self.left_out(index)),
                self._parts(index, "episodes", "counts"),
            )
            for index in self.finished
        ]

    def _parts(self, cell: int, *kinds: str) -> "_Parts":
        shards, at_once = tuple(self.shards_of[cell]), PART_ROWS // self.suite.scene.decisions
        return _Parts(self.folder, kinds, shards, at_once, self.left_out(cell))

    @cached_property
    def shards_of(self) -> Mapping[int, Sequence[Shard]]:
        """The shards of each cell; a suite can have 10,000 cells."""
        found: defaultdict[int, list[Shard]] = defaultdict(list)
        for shard in self.shards:
            found[shard.cell].append(shard)
        return found


@dataclass(frozen=True)
class _Parts:
    """The rows of some kinds of some shards, some shards at a time."""

    folder: RunFolder
    kinds: tuple[str, ...]
    shards: tuple[Shard, ...]
    episodes: int
    """About how many episodes a part has."""
    left_out: pl.Series
    """The seeds of the episodes that are left out."""

    def __iter__(self) -> Iterator[Rows]:
        count = max(1, self.episodes // max(shard.episodes for shard in self.shards))
        counts = ~pl.col("episode").is_in(self.left_out.implode())
        for start in range(0, len(self.shards), count):
            rows = read_rows(self.folder, self.kinds, self.shards[start : start + count])
            yield tuple(each.filter(counts) for each in rows) if len(self.left_out) else rows


def read_rows(folder: RunFolder, kinds: tuple[str, ...], shards: Sequence[Shard]) -> Rows:
    """Returns rows of some kinds of some shards; step rows come with their episode rows.

    Raises a `RunFolderError` if a file cannot be used, or step rows are not of the episode rows.
    """
    rows = tuple(folder.read(kind, shards) for kind in kinds)
    if kinds == EPISODES_AND_STEPS and (what := problem_of_steps(*rows)):
        raise RunFolderError(f"{folder.path}: {what}; run the suite again")
    return rows


def open_finished(path: Path) -> FinishedRun:
    """Opens a finished run; its folder is all that it needs.

    Raises a `RunFolderError` if the folder holds no run, an unfinished one, or a damaged one.
    """
    folder = RunFolder(path)
    suite = folder.suite()
    run = FinishedRun(suite, folder, folder.shards(suite))
    for index, cell in enumerate(suite.cells):
        present = sum(shard.episodes for shard in run.shards_of[index])
        if present != suite.episodes:
            raise RunFolderError(
                f"{path}: holds {present:,} of {suite.episodes:,} episodes of {cell.title}; "
                "finish the run with `charms-bench run`"
            )
    return run
