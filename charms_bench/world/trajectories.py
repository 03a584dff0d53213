"""Recorded traffic: the tracks of vehicles in the simulation's frame of reference."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.world.profile import CHARMS

UPPER, LOWER = 1, 2
"""Driving directions; the upper carriageway of the image drives towards smaller x."""
LANE_WIDTH_M = CHARMS.lane_width_m
STAY_S = 0.75
"""A shorter stay in a lane does not count as a lane change."""

TRACKS = {
    "vehicle": pl.Int64,
    "frame": pl.Int64,
    "direction": pl.Int8,
    "car": pl.Boolean,
    "x": pl.Float64,  # m, centre along the driving direction, from an arbitrary origin
    "y": pl.Float64,  # m, centre to the right
    "lane": pl.Int64,  # whose markings enclose the centre, or else the nearest
    "on_road": pl.Boolean,  # whether the centre lies between the outer markings
    "speed": pl.Float64,  # m/s, along x, as measured
    "lateral_speed": pl.Float64,  # m/s, to the right, as measured
    "acceleration": pl.Float64,  # m/s2, along x, as measured
    "length": pl.Float64,  # m
    "width": pl.Float64,  # m
}
"""The columns of `Recording.tracks`.

Within each lane y is stretched so that the centre of lane i, counted from the left, lies at 4 i.
"""


@dataclass(frozen=True)
class Trio:
    """The three files of a recording; all the same for a recording in one table."""

    number: int
    tracks: Path
    tracks_meta: Path
    recording_meta: Path

    @property
    def paths(self) -> tuple[Path, ...]:
        """All of them, each once."""
        return tuple(dict.fromkeys((self.tracks, self.tracks_meta, self.recording_meta)))


@dataclass(frozen=True)
class Recording:
    """The traffic that was filmed at one place at one time."""

    trio: Trio
    frame_rate_hz: float
    lanes: dict[int, int]
    """Number of lanes by direction; directions without vehicles are left out."""
    lane_widths_m: dict[int, Floats]
    """Widths of these lanes by direction, from left to right."""
    tracks: pl.DataFrame
    """One row per vehicle and frame, sorted by vehicle and frame; columns `TRACKS`."""
    lane_id_disagreements: int
    """Number of rows between the outer markings whose `laneId` contradicts y."""
    occasion: str
    """Location, month, weekday and start time, as far as they are stated. Recordings
    that state the same may overlap in time."""
    location: str
    """The location as stated; empty if it is not."""

    @property
    def lane_changes(self) -> pl.DataFrame:
        """One row per lane change between two lanes if the vehicle stays `STAY_S` in both.

        Columns vehicle, lane, next_lane, and the first and last frame of the stay in `lane`,
        called frame and last.
        """
        return (
            self.tracks.group_by("vehicle", pl.col("lane").rle_id().alias("stay"))
            .agg(pl.len(), pl.first("lane", "frame"), last=pl.last("frame"))
            .filter(pl.col("len") >= STAY_S * self.frame_rate_hz)
            .sort("vehicle", "frame")
            .with_columns(next_lane=pl.col("lane").shift(-1).over("vehicle"))
            .filter(pl.col("next_lane") != pl.col("lane"))
            .select("vehicle", "lane", "next_lane", "frame", "last")
        )


def slope(
    vehicle: pl.Series, frame: pl.Series, values: Floats, rate_hz: float, around: int = 1
) -> Floats:
    """How fast values change, per second, from `around` frames before to `around` frames after.

    Rows are sorted by vehicle and frame. At the ends of a vehicle's rows, fewer frames count; with
    a single frame, the result is 0.
    """
    vehicles, frames = vehicle.to_numpy(), frame.to_numpy()
    size = vehicles.size
    ends = np.flatnonzero(np.diff(vehicles, append=-1) != 0) if size else np.zeros(0, np.int64)
    begins = np.concatenate([[0], ends[:-1] + 1]) if size else ends
    lengths = ends - begins + 1
    first, last = np.repeat(begins, lengths), np.repeat(ends, lengths)
    before = np.maximum(np.arange(size) - around, first)
    after = np.minimum(np.arange(size) + around, last)
    duration_s = (frames[after] - frames[before]) / rate_hz
    change = values[after] - values[before]
    found: Floats = np.divide(change, duration_s, out=np.zeros(size), where=duration_s > 0)
    return found


def lateral(y: Floats, markings: Floats) -> tuple[Floats, Ints, Bools]:
    """Stretched y, lane and whether on the road, of positions to the right.

    A position on a marking belongs to the lane to its left, like highway-env's closest lane.
    """
    lane = np.clip(np.searchsorted(markings, y, side="left") - 1, 0, markings.size - 2)
    left, right = markings[lane], markings[lane + 1]
    stretched = LANE_WIDTH_M * (lane - 0.5 + (y - left) / (right - left))
    return stretched, lane, (markings[0] <= y) & (y <= markings[-1])
