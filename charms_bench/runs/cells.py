"""The rows of a cell: what was recorded of one ego in one traffic."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.errors import RegistryError
from charms_bench.foundation.words import counted
from charms_bench.metrics import Metric, sums_by_episode
from charms_bench.metrics.metric import problem_of_sums
from charms_bench.world.following_bins import BINS, QUANTITIES
from charms_bench.world.named_road import ENVIRONMENT
from charms_bench.world.scene import Floats, SceneSettings

Rows = tuple[pl.DataFrame, ...]
"""Rows of the same episodes, one frame per kind."""


def title_of(labels: Sequence[str]) -> str:
    """The name of a road and a traffic model together; on the straight road, of the latter."""
    road, traffic = labels[:-1], labels[-1]
    return ", ".join(road if road and traffic == ENVIRONMENT else labels)


@dataclass(frozen=True, eq=False)
class CellRows:
    """An ego on a road in a traffic, and the rows recorded of it."""

    agent: str
    traffic: str
    size: int
    parts: Iterable[Rows]
    """The episode rows and the step rows of some episodes at a time. They are read again each time,
    because all step rows of a long run do not fit into memory."""
    drivers: Iterable[Rows]
    """The driver rows of the same episodes at a time."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """Values that the paper reports, by metric of the set `paper`."""
    left_out: int = 0
    """Concrete scenarios without rows here, because prescribed vehicles collide in them."""
    road: str = ""
    """Empty for the straight road of the scene."""

    def __repr__(self) -> str:
        return f"<CellRows {self.agent} in {self.surroundings}: {counted(self.size, 'episode')}>"

    @property
    def surroundings(self) -> str:
        """The name of its road and its traffic model together."""
        return title_of(self.labels[1:])

    @property
    def labels(self) -> tuple[str, ...]:
        """Those of its rows in tables; see `Suite.with_road`."""
        return tuple(filter(None, (self.agent, self.road, self.traffic)))

    @cached_property
    def episodes(self) -> pl.DataFrame:
        """All episode rows."""
        return pl.concat(episodes for episodes, _ in self.parts)

    @cached_property
    def steps(self) -> pl.DataFrame:
        """All step rows."""
        return pl.concat(steps for _, steps in self.parts)

    def sums(self, metrics: Sequence[Metric], settings: SceneSettings) -> list[Floats]:
        """The sums [E, k] of each metric; a `RegistryError` if they are not those of its kind."""
        ends = np.cumsum([len(metric.sums) for metric in metrics])
        whole = np.empty((self.size, ends[-1]))
        start = 0
        for (episodes, steps), (drivers,) in zip(self.parts, self.drivers, strict=True):
            sums = sums_by_episode(
                metrics, episodes, steps, settings, drivers, self.left_out / self.size
            )
            end = start + len(sums[0])
            np.concatenate(sums, axis=1, out=whole[start:end])
            start = end
        found = np.split(whole, ends[:-1], axis=1)
        for metric, each in zip(metrics, found, strict=True):
            if problem := problem_of_sums(metric, each):
                raise RegistryError(f"metric '{metric.name}' in {self.agent}: {problem}")
        return found


@dataclass(frozen=True)
class TrafficCounts:
    """What the vehicles of a traffic did while they followed a leader."""

    traffic: str
    counts: NDArray[np.int32]
    """[E, 2, BINS] by episode, quantity and bin."""

    @classmethod
    def of(cls, traffic: str, size: int, parts: Iterable[Rows]) -> "TrafficCounts":
        """Makes the counts of a cell of `size` episodes from its rows `episodes` and `counts`."""
        counts = np.zeros((size, len(QUANTITIES), BINS), dtype=np.int32)
        start = 0
        for episodes, rows in parts:
            seeds = np.unique(episodes["episode"].to_numpy())
            quantity = rows["quantity"].replace_strict(QUANTITIES, range(len(QUANTITIES)))
            episode = start + np.searchsorted(seeds, rows["episode"].to_numpy())
            counts[episode, quantity.to_numpy(), rows["bin"].to_numpy()] = rows["count"].to_numpy()
            start += seeds.size
        return cls(traffic, counts)

    def of_quantity(self, quantity: str) -> NDArray[np.int32]:
        """Returns the counts [E, BINS] of one quantity."""
        return self.counts[:, QUANTITIES.index(quantity)]
