"""The shards of a run: which episodes they have, and how their files are named."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from charms_bench.runs.suite import Suite

SHARD_EPISODES = 150
"""Enough scenes for the compiled engine to be fast; few enough that a killed run loses little."""
NAME = "([0-9]{3,})-([0-9]{9,})-([0-9a-f]{16})"
"""The name of a shard's files: its cell, its first seed and the beginning of its key."""


@dataclass(frozen=True)
class Shard:
    """A fixed number of episodes of a cell."""

    cell: int
    """Index into `Suite.cells`."""
    first_seed: int
    episodes: int
    key: str
    """Hash of everything that its rows depend on."""
    ego: str | None = None
    """The agent of its ego as driver rows name it; None if only the name of its files is known."""

    @property
    def seeds(self) -> range:
        """Those of its episodes."""
        return range(self.first_seed, self.first_seed + self.episodes)

    @property
    def name(self) -> str:
        """Name of its files, without the ending."""
        return f"{self.cell:03d}-{self.first_seed:09d}-{self.key[:16]}"


Places = Mapping[tuple[int, int], int]
"""The number of episodes of each shard of a run, by its cell and its first seed."""


def blocks(suite: Suite) -> Iterator[tuple[int, int]]:
    """Yields the first seed and the number of episodes of each shard of a cell."""
    for start in range(0, suite.episodes, SHARD_EPISODES):
        yield suite.seed + start, min(SHARD_EPISODES, suite.episodes - start)


def places_of(suite: Suite) -> Places:
    """Returns the shards that a finished run of a suite has."""
    cells = range(len(suite.egos) * len(suite.surroundings))
    return {(cell, first): count for cell in cells for first, count in blocks(suite)}


def shard_named(name: str, places: Places) -> Shard | None:
    """Returns the shard whose files have this name; None if no shard of the run has it."""
    match = re.fullmatch(NAME, name)
    place = (int(match[1]), int(match[2])) if match else (-1, -1)
    if match is None or place not in places:
        return None
    shard = Shard(*place, places[place], match[3])
    return shard if shard.name == name else None
