"""The table of drivers: what each agent of a cell does to others, and what others do to it.

A mixed traffic has a row per agent, so the table shows what each driving style contributes.
"""

from dataclasses import astuple, replace
from itertools import product

import numpy as np
import polars as pl

from charms_bench.metrics import MetricSet
from charms_bench.metrics.conduct import OF_DRIVERS
from charms_bench.recording.columns import EGO_INDEX
from charms_bench.report.definitions import columns_of
from charms_bench.report.table import ESTIMATE, Column, Table, long_frame
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import estimate
from charms_bench.world.scene import Floats

KEYS = ("agent", "traffic", "driver")
LONG = {"metric": "name", **ESTIMATE}
EGO = "ego"
"""The name of the ego as a driver, because its agent may also drive vehicles of the traffic."""
_SUMS = [each.cast(pl.Float64) for metric in OF_DRIVERS for each in metric.sums]
_ENDS = np.cumsum([len(metric.sums) for metric in OF_DRIVERS])[:-1]


def part_of(suite: Suite, cell: CellRows) -> pl.DataFrame:
    """The part of one cell in the table's long frame, the ego first.

    The suite's seed is that of the resamples.
    """
    sums = _sums(cell)
    every = [each for of_driver in sums.values() for each in of_driver]
    estimates = estimate(OF_DRIVERS * len(sums), every, suite.seed)
    records = [
        (*cell.labels, driver, metric.name, *astuple(found))
        for (driver, metric), found in zip(product(sums, OF_DRIVERS), estimates, strict=True)
        # The ego's fault on a road is in the column `at_fault_on_road` of its episodes.
        if metric.name != "crashed_at_fault" or not (cell.road and driver == EGO)
    ]
    return long_frame(records, suite.with_road(KEYS), LONG)


def _sums(cell: CellRows) -> dict[str, list[Floats]]:
    """The sums [E, k] of each metric by driver; a driver without vehicles in an episode has 0."""
    found: dict[str, Floats] = {}
    start = 0
    for (drivers,) in cell.drivers:
        if EGO_INDEX in drivers.columns:  # the traffic of an episode is in the rows of each ego
            drivers = drivers.filter(pl.col("is_ego") | (pl.col(EGO_INDEX) == 0))
        ordered = drivers.sort("is_ego", "agent", descending=[True, False])
        episodes = np.unique(drivers["episode"].to_numpy())
        for (is_ego, agent), rows in ordered.group_by("is_ego", "agent", maintain_order=True):
            whole = found.setdefault(EGO if is_ego else agent, np.zeros((cell.size, len(_SUMS))))
            values = rows.select(each.alias(str(k)) for k, each in enumerate(_SUMS))
            place = np.searchsorted(episodes, rows["episode"].to_numpy())
            np.add.at(whole, start + place, values.to_numpy())  # two names may be one network
        start += episodes.size
    return {driver: np.split(whole, _ENDS, axis=1) for driver, whole in found.items()}


def from_frame(frame: pl.DataFrame, suite: Suite) -> Table:
    """The metrics of every driver of every cell with 95 % intervals, from the long frame."""
    known = columns_of(MetricSet("drivers", 1, OF_DRIVERS))

    def column(_: str, metric: str) -> Column:
        unknown = Column(metric, definition="Unknown: written by another version")
        return replace(known.get(metric, unknown), group="")

    return Table.from_frame(
        frame,
        f"{suite.suite}-drivers",
        "What each driver does to others, and others to it",
        suite.with_road(KEYS),
        LONG,
        column,
        note="Sums over all vehicles of a driver, until each collides or leaves the road. The "
        "thresholds were applied during the simulation.",
    )
