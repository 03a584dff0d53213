"""What all vehicles of a scene do while they follow, counted in bins: realism is read from it.

Two quantities of the paper's realism test, taken at every decision of every vehicle that drives
with a leader within 50 m in its lane, centre to centre: its speed, and, in the step in which it
starts a lane change, its distance headway to that leader.
"""

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.world.scene import Ints, Scene

FOLLOWING_RANGE_M = 50.0
"""A driver follows the leader within this distance, centre to centre."""
BIN = 0.5
"""Width of a bin: m/s of the speeds, m of the headways."""
BINS = 100
"""The last bin also takes what lies beyond it."""
QUANTITIES = ("speed", "dhw")

COUNT_SCHEMA = pl.Schema(
    {
        "episode": pl.UInt64(),  # the episode's seed
        "quantity": pl.String(),  # speed while following, dhw at the start of a lane change
        "bin": pl.Int16(),  # from bin * BIN on
        "count": pl.Int32(),  # vehicles, each at a decision
    }
)


class FollowingCounts:
    """Counts of B scenes; call `note` after every decision interval."""

    def __init__(self, scene: Scene) -> None:
        self._counts = np.zeros((scene.ego.size, len(QUANTITIES), BINS), dtype=np.int64)
        self._target_lane = scene.target_lane.copy()

    def note(self, scene: Scene, rows: Ints) -> None:
        """Counts the vehicles of the scenes `rows`."""
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
        """The counts above 0 (`COUNT_SCHEMA`), by episode, quantity and bin."""
        scene, quantity, bin_ = np.nonzero(self._counts)
        columns: dict[str, Any] = {
            "episode": episodes[scene],
            "quantity": np.array(QUANTITIES)[quantity],
            "bin": bin_,
            "count": self._counts[scene, quantity, bin_],
        }
        return pl.DataFrame(columns).cast(COUNT_SCHEMA).sort("episode", "quantity", "bin")


def bins_of(values: NDArray[np.float64]) -> Ints:
    """The bin of each value."""
    return (values / BIN).astype(np.int64).clip(0, BINS - 1)
