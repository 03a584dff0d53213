"""Finished runs, opened from their folders: the rows of every cell."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from charms_bench.errors import CharmsBenchError, RunFolderError
from charms_bench.runs.cells import CellRows, Rows, TrafficCounts
from charms_bench.runs.resumable_folder import RunFolder
from charms_bench.runs.shard_rows import problem_of_steps
from charms_bench.runs.shards import Shard
from charms_bench.runs.suite import Suite

EPISODES_AND_STEPS = ("episodes", "steps")
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
        return CellRows(
            agent=cell.ego.title,
            traffic=cell.traffic.title,
            size=self.suite.episodes,
            parts=self._parts(index, *EPISODES_AND_STEPS),
            drivers=self._parts(index, "drivers"),
            paper=cell.paper,
        )

    def following(self) -> list[TrafficCounts]:
        """Returns what the vehicles of every finished cell did while they followed a leader.

        Raises:
            RunFolderError: A file is missing or has changed since it was written.
        """
        return [
            TrafficCounts.of(
                self.suite.cells[index].traffic.title,
                self.suite.episodes,
                self._parts(index, "episodes", "counts"),
            )
            for index in self.finished
        ]

    def _parts(self, cell: int, *kinds: str) -> "_Parts":
        shards = tuple(self._of_cells[cell])
        return _Parts(self.folder, kinds, shards, PART_ROWS // self.suite.scene.decisions)

    @cached_property
    def _of_cells(self) -> Mapping[int, Sequence[Shard]]:
        """The shards of each cell; a suite can have 10,000 cells."""
        found: dict[int, list[Shard]] = {index: [] for index in range(len(self.suite.cells))}
        for shard in self.shards:
            found.setdefault(shard.cell, []).append(shard)
        return found


@dataclass(frozen=True)
class _Parts:
    """The rows of some kinds of some shards, some shards at a time."""

    folder: RunFolder
    kinds: tuple[str, ...]
    shards: tuple[Shard, ...]
    episodes: int
    """About how many episodes a part has."""

    def __iter__(self) -> Iterator[Rows]:
        count = max(1, self.episodes // max(shard.episodes for shard in self.shards))
        for start in range(0, len(self.shards), count):
            yield read_rows(self.folder, self.kinds, self.shards[start : start + count])


def read_rows(folder: RunFolder, kinds: tuple[str, ...], shards: Sequence[Shard]) -> Rows:
    """Returns rows of some kinds of some shards; step rows come with their episode rows.

    Raises:
        RunFolderError: A file cannot be used, or step rows are not those of the episode rows.
    """
    rows = tuple(folder.read(kind, shards) for kind in kinds)
    if kinds == EPISODES_AND_STEPS and (what := problem_of_steps(*rows)):
        raise RunFolderError(f"{folder.path}: {what}; run the suite again")
    return rows


def open_finished(path: Path) -> FinishedRun:
    """Opens a finished run; its folder is all that it needs.

    Raises:
        RunFolderError: The folder holds no run, an unfinished one, or a damaged one.
    """
    folder = RunFolder(path)
    suite = folder.suite()
    shards = folder.shards(suite)
    episodes: Counter[int] = Counter()
    for shard in shards:
        episodes[shard.cell] += shard.episodes
    for index, cell in enumerate(suite.cells):
        present = episodes[index]
        if present != suite.episodes:
            raise RunFolderError(
                f"{path}: holds {present:,} of {suite.episodes:,} episodes of {cell.title}; "
                "finish the run with `charms-bench run`"
            )
    return FinishedRun(suite, folder, shards)
