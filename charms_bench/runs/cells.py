"""The rows of a cell: what was recorded of one ego in one traffic."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import polars as pl

from charms_bench.engine.following import BINS, QUANTITIES
from charms_bench.world.scene import Floats


@dataclass(frozen=True)
class CellRows:
    """An ego in a traffic, and the rows recorded of it."""

    agent: str
    traffic: str
    episodes: pl.DataFrame
    steps: pl.DataFrame
    paper: Mapping[str, float] = field(default_factory=dict)
    """Values that the paper reports, by metric of the set `paper`."""


@dataclass(frozen=True)
class TrafficCounts:
    """What the vehicles of a traffic did while they followed a leader."""

    traffic: str
    counts: Floats
    """[E, 2, BINS] by episode, quantity and bin."""

    @classmethod
    def of(cls, traffic: str, episodes: pl.DataFrame, rows: pl.DataFrame) -> "TrafficCounts":
        """Makes the counts of a cell from its rows `episodes` and `counts`."""
        seeds = np.sort(episodes["episode"].to_numpy())
        counts = np.zeros((seeds.size, len(QUANTITIES), BINS))
        quantity = rows["quantity"].replace_strict(QUANTITIES, range(len(QUANTITIES)))
        episode = np.searchsorted(seeds, rows["episode"].to_numpy())
        counts[episode, quantity.to_numpy(), rows["bin"].to_numpy()] = rows["count"].to_numpy()
        return cls(traffic, counts)

    def of_quantity(self, quantity: str) -> Floats:
        """Returns the counts [E, BINS] of one quantity."""
        return self.counts[:, QUANTITIES.index(quantity)]
