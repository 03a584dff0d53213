"""The table of preventable collisions: those in episodes in which a reference driver has none.

All egos of a suite drive the same episodes, so in a suite of scenarios the reference driver meets
the same concrete scenario.
"""

from collections.abc import Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.metrics.collisions import ENDED_BADLY
from charms_bench.report.table import Column, Table, long_schema
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import wilson

KEYS = ("agent", "traffic")
LONG = {"share": "name", "value": "value", "low": "low", "high": "high", "n": "n"}
COLUMNS = {
    "crashed": "share of episodes in which the ego collides or leaves the road",
    "preventable": "share of episodes in which it does so and {} does not",
    "not_preventable": "share of episodes in which both do so",
}


def crashed(cell: CellRows) -> NDArray[np.bool_]:
    """Returns whether the ego crashed, in each episode of a cell, by seed."""
    rows = cell.episodes.sort("episode").group_by("episode", maintain_order=True).agg(ENDED_BADLY)
    return rows["ending"].to_numpy().astype(np.bool_)


def preventable_table(suite: Suite, cells: Sequence[CellRows]) -> Table:
    """The shares of preventable and other collisions of every cell, with 95 % intervals."""
    reference = {
        cell.traffic: crashed(cell) for cell in cells if cell.agent == suite.preventable_by
    }
    records = []
    for cell in cells:
        mine, unavoidable = crashed(cell), reference[cell.traffic]
        counts = (mine.sum(), (mine & ~unavoidable).sum(), (mine & unavoidable).sum())
        for name, count in zip(COLUMNS, counts, strict=True):
            value, bounds = int(count) / mine.size, wilson(int(count), mine.size)
            records.append((cell.agent, cell.traffic, name, value, *bounds, mine.size))
    return from_frame(pl.DataFrame(records, schema=long_schema(KEYS, LONG), orient="row"), suite)


def from_frame(frame: pl.DataFrame, suite: Suite) -> Table:
    """The table of preventable collisions from its long frame."""

    def column(_: str, name: str) -> Column:
        return Column(
            name=name,
            definition=COLUMNS.get(name, "").format(suite.preventable_by),
            counted="episodes",
            interval="Wilson's score interval of a share of episodes",
            form=".1%",
        )

    return Table.from_frame(
        frame,
        f"{suite.suite}-preventable",
        "Preventable collisions",
        KEYS,
        LONG,
        column,
        note=f"A collision is preventable if {suite.preventable_by} avoids it in the same episode.",
    )
