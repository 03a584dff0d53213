"""Finished runs, opened from their folders: the rows of every cell."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from charms_bench.errors import RunFolderError
from charms_bench.runs.cells import CellRows, TrafficCounts
from charms_bench.runs.folder import RunFolder, Shard
from charms_bench.runs.suite import Cell, Suite


@dataclass(frozen=True)
class FinishedRun:
    """A suite whose shards are all in a run folder."""

    suite: Suite
    folder: RunFolder
    shards: tuple[Shard, ...]

    def cells(self) -> list[CellRows]:
        """Returns the episode and step rows of every cell.

        Raises:
            RunFolderError: A file is missing or has changed since it was written.
        """
        return [
            CellRows(
                agent=cell.ego.title,
                traffic=cell.traffic.title,
                episodes=self.folder.read("episodes", shards),
                steps=self.folder.read("steps", shards),
                paper=cell.paper,
            )
            for cell, shards in self._shards_by_cell()
        ]

    def following(self) -> list[TrafficCounts]:
        """Returns what the vehicles of every cell did while they followed a leader.

        Raises:
            RunFolderError: A file is missing or has changed since it was written.
        """
        return [
            TrafficCounts.of(
                cell.traffic.title,
                self.folder.read("episodes", shards),
                self.folder.read("counts", shards),
            )
            for cell, shards in self._shards_by_cell()
        ]

    def _shards_by_cell(self) -> Iterator[tuple[Cell, list[Shard]]]:
        for index, cell in enumerate(self.suite.cells):
            yield cell, [shard for shard in self.shards if shard.cell == index]


def open_finished(path: Path) -> FinishedRun:
    """Opens a finished run; its folder is all that it needs.

    Raises:
        RunFolderError: The folder holds no run, an unfinished one, or a damaged one.
    """
    folder = RunFolder(path)
    suite = folder.suite()
    shards = folder.shards()
    for index, cell in enumerate(suite.cells):
        present = sum(shard.episodes for shard in shards if shard.cell == index)
        if present != suite.episodes:
            raise RunFolderError(
                f"{path}: holds {present:,} of {suite.episodes:,} episodes of {cell.ego.title} in "
                f"{cell.traffic.title}; finish the run with `charms-bench run`"
            )
    return FinishedRun(suite, folder, shards)
