"""What recorded drivers do while they follow: the quantities of `recording.following_counts`.

A recording does not tell when a driver decided to change lanes. Here a lane change starts at the
last moment before the vehicle leaves its lane at which it does not yet move towards the new lane.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import polars as pl

from charms_bench.humans.situations import at_decisions
from charms_bench.world.following_bins import FOLLOWING_RANGE_M
from charms_bench.world.road import NEIGHBOUR_MARGIN_M
from charms_bench.world.scene import Floats, Ints
from charms_bench.world.trajectories import LANE_WIDTH_M, Recording

DECISION_HZ = 3
"""The rate at which the simulation counts."""
LANE_CHANGE_SPEED_MPS = 0.07
"""A vehicle that moves sideways faster than this moves towards another lane."""
FEWEST_RECORDINGS = 10
"""With as many recordings, they are the independent units; with fewer, vehicles are."""
_ON_LANE_M = LANE_WIDTH_M / 2 + NEIGHBOUR_MARGIN_M
"""A vehicle is on a lane while its centre is this close to the lane's; see `Scene.leader`."""


@dataclass(frozen=True)
class Followers:
    """What drivers do who have a leader within 50 m in their lane, centre to centre."""

    speed: Floats
    """Speed along the road of each driver at each decision, m/s."""
    dhw: Floats
    """Distance headway to the leader at each start of a lane change, m."""
    speed_units: Ints
    dhw_units: Ints
    """The number of the independent unit of each value."""
    unit: str
    """What a unit is: a recording or a vehicle."""
    vehicles: int
    """Number of recorded vehicles, with or without a leader."""
    lane_changes: int
    """Number of recorded lane changes, with or without a leader."""


def followers(recordings: Iterable[Recording]) -> Followers:
    """The followers in recordings, trucks and both carriageways included.

    Raises a `DataError` if the frame rate is below the decision rate.
    """
    speeds, headways, vehicles, lane_changes = [], [], 0, 0
    for number, recording in enumerate(recordings):
        in_recording = pl.lit(number).alias("recording")
        decided = recording.tracks.filter(at_decisions(recording, DECISION_HZ))
        speeds.append(_following(decided).select(in_recording, "vehicle", value="speed"))
        starts = lane_change_starts(recording)
        at_starts = recording.tracks.join(starts.select("frame").unique(), on="frame", how="semi")
        found = _following(at_starts).join(starts, on=["vehicle", "frame"], how="semi")
        headways.append(found.select(in_recording, "vehicle", value="leader_distance"))
        vehicles += recording.tracks["vehicle"].n_unique()
        lane_changes += recording.lane_changes.height
    unit = "recording" if len(speeds) >= FEWEST_RECORDINGS else "vehicle"
    speed, dhw = (_by_unit(pl.concat(each), unit) for each in (speeds, headways))
    return Followers(speed[0], dhw[0], speed[1], dhw[1], unit, vehicles, lane_changes)


def _by_unit(values: pl.DataFrame, unit: str) -> tuple[Floats, Ints]:
    """The values and the numbers of their units."""
    keys = ["recording", "vehicle"] if unit == "vehicle" else ["recording"]
    numbers = pl.struct(keys).rank("dense")
    return values["value"].to_numpy(), values.select(numbers).to_series().to_numpy()


def lane_change_starts(recording: Recording) -> pl.DataFrame:
    """The vehicle and the first frame of each lane change; columns vehicle and frame.

    A lane change has no known start if the vehicle already moves towards the new lane when it is
    first seen, or when it enters the lane that it leaves. Such a lane change is left out.
    """
    changes = recording.lane_changes.rename({"lane": "left", "frame": "first"})
    towards = (pl.col("next_lane") - pl.col("left")).sign() * pl.col("lateral_speed")
    return (
        recording.tracks.join(changes, on="vehicle")
        .filter(pl.col("frame").is_between("first", "last"), towards <= LANE_CHANGE_SPEED_MPS)
        .group_by("vehicle", "last")
        .agg(pl.col("frame").max())
        .select("vehicle", "frame")
        .sort("vehicle", "frame")
    )


def _following(tracks: pl.DataFrame) -> pl.DataFrame:
    """The rows on the road with a leader within 50 m, with the column `leader_distance`."""
    place = pl.col("y") / LANE_WIDTH_M
    where = ("direction", "frame", "place")
    return (
        tracks.with_columns(place=pl.concat_list(place.floor(), place.floor() + 1))
        .explode("place")
        .filter((place - pl.col("place")).abs() <= _ON_LANE_M / LANE_WIDTH_M)
        .sort(*where, "x", "vehicle")
        .with_columns(leader_distance=pl.col("x").shift(-1).over(where) - pl.col("x"))
        .filter(
            pl.col("on_road"),
            pl.col("place") == pl.col("lane"),
            pl.col("leader_distance") <= FOLLOWING_RANGE_M,
        )
    )
