"""Counts what all vehicles of a scene do while they follow a leader, in bins.

The paper's realism test compares two quantities. They are taken at every decision interval, from
every vehicle that has a leader within 50 m on its lane, centre to centre: the vehicle's speed, and
its distance headway to that leader in the interval in which it starts a lane change.
"""

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.engine.columns import COUNT_SCHEMA, table
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.world.following import BINS, FOLLOWING_RANGE_M, QUANTITIES, bins_of
from charms_bench.world.road import is_on_lane
from charms_bench.world.scene import Ints, Scene


class FollowingCounts:
    """Counts for B scenes; call `note` after every decision interval."""

    def __init__(self, scene: Scene) -> None:
        self._counts = np.zeros((scene.ego.size, len(QUANTITIES), BINS), dtype=np.int64)
        self._target_lane = scene.target_lane.copy()

    def note(self, scene: Scene, scenes: Ints) -> None:
        """Adds the vehicles of the scenes (S,)."""
        _count(scene, scenes, self._target_lane, self._counts)

    def table(self, episodes: NDArray[np.uint64]) -> pl.DataFrame:
        """Returns the counts above 0 (`rows.COUNT`), sorted by episode, quantity and bin."""
        scene, quantity, bin_ = np.nonzero(self._counts)
        columns = {
            "episode": episodes[scene],
            "quantity": np.array(QUANTITIES)[quantity],
            "bin": bin_,
            "count": self._counts[scene, quantity, bin_],
        }
        return table(columns, COUNT_SCHEMA).sort("episode", "quantity", "bin")


@compiled_of_scenes
def _count(scene: Scene, scenes: Ints, target_lane: Ints, counts: Ints) -> None:
    """Adds to `counts` [B, 2, BINS]; `target_lane` [B, N] becomes that of the scenes."""
    speed, dhw = 0, 1
    for b in scenes:
        for i in range(scene.x.shape[1]):
            x, lane, target = scene.x[b, i], scene.lane[b, i], scene.target_lane[b, i]
            starts = target not in (target_lane[b, i], lane)
            target_lane[b, i] = target
            on_road = is_on_lane(scene.constants, lane, x, scene.y[b, i], 0.0)
            leader = scene.leaders[b, i, lane]
            if scene.crashed[b, i] or not on_road or leader < 0:
                continue
            distance = scene.x[b, leader] - x
            if distance <= FOLLOWING_RANGE_M:
                counts[b, speed, bins_of(scene.speed[b, i])] += 1
                if starts:
                    counts[b, dhw, bins_of(distance)] += 1
