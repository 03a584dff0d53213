"""The most critical episodes of a run, in order, and what happened in each."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench.episodes.criticality import IS_OF_KIND, Kind, criticality
from charms_bench.episodes.replay import Replay, replay
from charms_bench.episodes.what_happened import gave_way, what_happened
from charms_bench.runs.finished import FinishedRun

AT_ONCE = 20
"""Episodes that are simulated again together: few enough for the memory of large scenes."""


@dataclass(frozen=True)
class EdgeCase:
    """An episode among the most critical."""

    rank: int
    """From 1."""
    ego: str
    """Title of the ego."""
    traffic: str
    episode: int
    """Its seed."""
    criticality: float
    """See `charms_bench.episodes.criticality`, as for the measures."""
    ending: str
    ttc_min_s: float | None
    drac_max_mps2: float | None
    imposed_braking_mps2: float | None
    abandoned_changes: int
    what: str
    """What happened, in a line."""

    def to_dict(self) -> dict[str, Any]:
        """Its fields, ready for JSON."""
        return asdict(self)


def edge_cases(
    run: FinishedRun, top: int, kind: Kind | None, cells: Sequence[int], folder: Path
) -> list[EdgeCase]:
    """The most critical episodes, ranked; of equally critical ones the first cell's and seed's.

    Args:
        run: A finished run.
        top: How many at most.
        kind: Only episodes of that kind, described as such. An abandoned lane change counts
            where another vehicle took the gap, which the episode is simulated again for.
        cells: Which cells of the suite.
        folder: Where paths of networks in the suite start.

    Raises:
        CharmsBenchError: As for `replay.replay`.
    """
    measured = ranked(run, cells)
    if kind is not None:
        measured = measured.filter(IS_OF_KIND[kind])
    found: list[EdgeCase] = []
    for row, replayed in _replays(run, measured, folder):
        if kind == "abandoned-lane-change" and not gave_way(replayed):
            continue
        cell = run.suite.cells[row["cell"]]
        found.append(
            EdgeCase(
                rank=len(found) + 1,
                ego=cell.ego.title,
                traffic=cell.traffic.title,
                what=what_happened(replayed, kind),
                **{name: row[name] for name in _MEASURED},
            )
        )
        if len(found) == top:
            break
    return found


_MEASURED = (
    "episode", "criticality", "ending", "ttc_min_s", "drac_max_mps2", "imposed_braking_mps2",
    "abandoned_changes",
)  # fmt: skip


def ranked(run: FinishedRun, cells: Sequence[int]) -> pl.DataFrame:
    """Every episode of these cells, the most critical first: `criticality`, and its `cell`."""
    rows = run.cells()
    frames = [
        criticality(rows[cell].episodes, rows[cell].steps, run.suite.scene).with_columns(
            cell=pl.lit(cell)
        )
        for cell in cells
    ]
    order = ["criticality", "cell", "episode"]
    return pl.concat(frames).sort(order, descending=[True, False, False])


def _replays(
    run: FinishedRun, measured: pl.DataFrame, folder: Path
) -> Iterator[tuple[dict[str, Any], Replay]]:
    """The rows in their order, each with its replay; simulated as far as is asked for."""
    for part in measured.iter_slices(AT_ONCE):
        replays = {
            (cell, replayed.episode): replayed
            for (cell,), mine in part.group_by("cell")
            for replayed in replay(run, int(str(cell)), mine["episode"].to_list(), folder)
        }
        for row in part.iter_rows(named=True):
            yield row, replays[row["cell"], row["episode"]]
