"""Counts what all vehicles of a scene do while they follow a leader, in bins.

The paper's realism test compares two quantities. They are taken at every decision interval, from
every vehicle that has a leader within 50 m on its lane, centre to centre: the vehicle's speed, and
its distance headway to that leader in the interval in which it starts a lane change.
"""

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.engine.columns import COUNT_SCHEMA, table
from charms_bench.world.scene import Ints, Scene

FOLLOWING_RANGE_M = 50.0
"""A vehicle follows a leader that is at most this far ahead, centre to centre."""
BIN = 0.5
"""Width of a bin: m/s for speeds, m for headways."""
BINS = 100
"""Number of bins; the last bin has no upper edge."""
QUANTITIES = ("speed", "dhw")


class FollowingCounts:
    """Counts for B scenes; call `note` after every decision interval."""

    def __init__(self, scene: Scene) -> None:
        self._counts = np.zeros((scene.ego.size, len(QUANTITIES), BINS), dtype=np.int64)
        self._target_lane = scene.target_lane.copy()

    def note(self, scene: Scene, rows: Ints) -> None:
        """Adds the vehicles of the scenes `rows` (R,)."""
        lane, target = scene.lane[rows], scene.target_lane[rows]
        starts = (target != self._target_lane[rows]) & (target != lane)
        self._target_lane[rows] = target
        drives = ~(scene.crashed | scene.off_road)[rows]
        which, vehicle = np.nonzero(drives)
        vehicles = rows[which], vehicle
        leader, present = scene.leader(vehicles, lane[which, vehicle])
        distance = scene.x[vehicles[0], leader] - scene.x[vehicles]
        follows = present & (distance <= FOLLOWING_RANGE_M)
        self._add(vehicles[0][follows], 0, scene.speed[vehicles][follows])
        starts_now = follows & starts[which, vehicle]
        self._add(vehicles[0][starts_now], 1, distance[starts_now])

    def _add(self, scenes: Ints, quantity: int, values: NDArray[np.float64]) -> None:
        cells = scenes * BINS + bins_of(values)
        counted = np.bincount(cells, minlength=len(self._counts) * BINS)
        self._counts[:, quantity] += counted.reshape(-1, BINS)

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


def bins_of(values: NDArray[np.float64]) -> Ints:
    """Returns the bin of each value."""
    return (values / BIN).astype(np.int64).clip(0, BINS - 1)
