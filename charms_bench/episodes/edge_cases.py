"""Ranks the episodes of a run by criticality and says what happened in the most critical ones."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from charms_bench.episodes.criticality import IS_OF_KIND, Kind, criticality
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import Replay, replay
from charms_bench.episodes.what_happened import what_happened
from charms_bench.recording.columns import of_ego
from charms_bench.runs.cells import title_of

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
    preventable: str | None = None
    """Whether the suite's reference drivers, which drive the same episode, avoid the collision:
    `yes`, `no` or `only by NAME`; None without reference drivers, and if there is none."""
    road: str | None = None
    """Title of the road; None for the straight road of the scene."""
    ego_index: int | None = None
    """Which of several egos; None if there is one."""

    def __repr__(self) -> str:
        which = "" if self.ego_index is None else f" ego {self.ego_index},"
        where = f"{self.ego} in {title_of(self.labels[1:])},{which} episode {self.episode}"
        return f"<EdgeCase {self.rank}: {where}, criticality {self.criticality:z.2f}: {self.what}>"

    @property
    def labels(self) -> tuple[str, ...]:
        """Those of its cell in tables."""
        return tuple(filter(None, (self.ego, self.road, self.traffic)))


def edge_cases(cells: Sequence[RecordedCell], top: int, kind: Kind | None) -> list[EdgeCase]:
    """Returns at most `top` of the most critical episodes, ranked; ties go by cell, then by seed.

    If a `kind` is given, they are of this kind, and `what` describes that event. An abandoned lane
    change counts if another vehicle took the gap (`recording.lane_changes`). Raises what `replay`
    does.
    """
    measured = ranked(cells).drop("kind")
    if kind is not None:
        measured = measured.filter(IS_OF_KIND[kind])
    return [
        EdgeCase(
            rank,
            replayed.cell.ego.title,
            replayed.cell.traffic.title,
            what=what_happened(replayed, kind),
            road=replayed.cell.road.title if replayed.cell.road else None,
            ego_index=replayed.ego_index,
            **row,
        )
        for rank, (row, replayed) in enumerate(_replays(cells, measured.head(top)), start=1)
    ]


def ranked(cells: Sequence[RecordedCell]) -> pl.DataFrame:
    """Returns the rows of `criticality` of all episodes of a run's cells, most critical first.

    `gaps_lost` is that of the ego's driver row, and `cell` the place of the episode's cell among
    the cells.
    """
    frames = []
    for place, each in enumerate(cells):
        for rows, (drivers,) in zip(each.rows.parts, each.rows.drivers, strict=True):
            episodes, steps, lost = (of_ego(part, each.ego_index) for part in (*rows, drivers))
            lost = lost.filter("is_ego").select("episode", "gaps_lost")
            measured = criticality(episodes, steps, each.run.suite.scene).join(lost, on="episode")
            frames.append(measured.with_columns(cell=pl.lit(place)))
    order = ["criticality", "cell", "episode"]
    return pl.concat(frames).sort(order, descending=[True, False, False])


def _replays(
    cells: Sequence[RecordedCell], measured: pl.DataFrame
) -> Iterator[tuple[dict[str, Any], Replay]]:
    """Yields each row with its replay, in order; simulates only as many as are consumed."""
    for part in measured.iter_slices(AT_ONCE):
        replays = {
            (place, replayed.episode): replayed
            for place, each in enumerate(cells)
            if (mine := part.filter(cell=place)["episode"].to_list())
            for replayed in replay(each, mine)
        }
        for row in part.iter_rows(named=True):
            yield row, replays[row.pop("cell"), row["episode"]]
