"""Counts what all vehicles of a scene do while they follow a leader, in bins.

The paper's realism test compares two quantities. They are taken at every decision interval, from
every vehicle that has a leader within 50 m on its lane, centre to centre: the vehicle's speed, and
its distance headway to that leader in the interval in which it starts a lane change.
"""

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.foundation.compiled import compiled
from charms_bench.recording.columns import COUNT_SCHEMA, table
from charms_bench.recording.primitives import Frames, distance_to
from charms_bench.world.following_bins import BINS, FOLLOWING_RANGE_M, QUANTITIES, bins_of
from charms_bench.world.road import Straight
from charms_bench.world.scene import Ints


class FollowingCounts:
    """Counts for B scenes."""

    def __init__(self, scenes: int, road: Straight) -> None:
        self._road, self._counts = road, np.zeros((scenes, len(QUANTITIES), BINS), dtype=np.int64)

    def add(self, frames: Frames) -> None:
        """Adds the vehicles of some frames."""
        count_followers(self._road, *frames, self._counts)

    def table(self, episodes: NDArray[np.uint64]) -> pl.DataFrame:
        """Returns the counts above 0 (`columns.COUNT`), sorted by episode, quantity and bin."""
        scene, quantity, bin_ = np.nonzero(self._counts)
        columns = {
            "episode": episodes[scene],
            "quantity": np.array(QUANTITIES)[quantity],
            "bin": bin_,
            "count": self._counts[scene, quantity, bin_],
        }
        return table(columns, COUNT_SCHEMA).sort("episode", "quantity", "bin")


@compiled
def count_followers(road: Straight, moments: Any, vehicles: Any, counts: Ints) -> None:
    """Adds to `counts` [B, 2, BINS]."""
    speed, dhw = 0, 1
    for moment in moments:
        now, before = vehicles[moment.now], vehicles[moment.before]
        for i in range(now.size):
            own = now[i]
            if own.crashed or not own.is_on_road or own.leader < 0:
                continue
            distance = distance_to(road, own, now[own.leader])
            if distance <= FOLLOWING_RANGE_M:
                counts[moment.scene, speed, bins_of(own.speed)] += 1
                if own.target_lane not in (before[i].target_lane, own.lane):
                    counts[moment.scene, dhw, bins_of(distance)] += 1
