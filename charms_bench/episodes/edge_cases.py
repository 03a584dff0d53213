"""Ranks the episodes of a run by criticality and says what happened in the most critical ones."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench.episodes.criticality import IS_OF_KIND, Kind, criticality
from charms_bench.episodes.replay import Replay, replay
from charms_bench.episodes.what_happened import what_happened
from charms_bench.runs.finished import FinishedRun

AT_ONCE = 20
"""Episodes simulated together; limits the memory that large scenes need."""


@dataclass(frozen=True)
class EdgeCase:
    """One of the most critical episodes of a run; the measures are those of `criticality`."""

    rank: int
    """Counted from 1."""
    ego: str
    """Title of the ego."""
    traffic: str
    """Title of the traffic."""
    episode: int
    """Seed of the episode."""
    criticality: float
    ending: str
    ttc_min_s: float | None
    drac_max_mps2: float | None
    imposed_braking_mps2: float | None
    abandoned_changes: int
    gaps_lost: int
    """How many lane changes the ego abandoned because another vehicle took the gap."""
    what: str
    """One sentence about what happened."""


def edge_cases(
    run: FinishedRun, top: int, kind: Kind | None, cells: Sequence[int], folder: Path
) -> list[EdgeCase]:
    """Returns the most critical episodes, ranked; ties go by cell, then by seed.

    Args:
        run: A finished run.
        top: The largest number of episodes to return.
        kind: Only episodes of this kind, and `what` describes that event. An abandoned lane change
            counts if another vehicle took the gap (`engine.lane_changes`).
        cells: Indices of the cells to search.
        folder: The folder that relative paths of networks in the suite start from.

    Raises:
        CharmsBenchError: As for `replay.replay`.
    """
    measured = ranked(run, cells).drop("kind")
    if kind is not None:
        measured = measured.filter(IS_OF_KIND[kind])
    found: list[EdgeCase] = []
    for row, replayed in _replays(run, measured.head(top), folder):
        ego, traffic = replayed.cell.ego.title, replayed.cell.traffic.title
        what = what_happened(replayed, kind)
        found.append(EdgeCase(len(found) + 1, ego, traffic, what=what, **row))
    return found


def ranked(run: FinishedRun, cells: Sequence[int]) -> pl.DataFrame:
    """Returns the rows of `criticality` of all episodes of these cells, most critical first.

    The column `gaps_lost` is that of the ego's driver row, and `cell` is the index of the
    episode's cell.
    """
    rows = run.cells()
    frames = [
        criticality(episodes, steps, run.suite.scene)
        .join(drivers.filter("is_ego").select("episode", "gaps_lost"), on="episode")
        .with_columns(cell=pl.lit(cell))
        for cell in cells
        for (episodes, steps), (drivers,) in zip(rows[cell].parts, rows[cell].drivers, strict=True)
    ]
    order = ["criticality", "cell", "episode"]
    return pl.concat(frames).sort(order, descending=[True, False, False])


def _replays(
    run: FinishedRun, measured: pl.DataFrame, folder: Path
) -> Iterator[tuple[dict[str, Any], Replay]]:
    """Yields each row with its replay, in order; simulates only as many as are consumed."""
    for part in measured.iter_slices(AT_ONCE):
        replays = {
            (cell, replayed.episode): replayed
            for (cell,), mine in part.group_by("cell")
            for replayed in replay(run, int(str(cell)), mine["episode"].to_list(), folder)
        }
        for row in part.iter_rows(named=True):
            yield row, replays[row.pop("cell"), row["episode"]]
