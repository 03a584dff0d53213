"""What recorded drivers do while they follow: the quantities that `engine.following` counts.

A recording says where vehicles were, not when a driver decided: a lane change starts at the last
moment before the vehicle leaves its lane's stay at which it was not yet moving sideways towards
the new lane.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import polars as pl

from charms_bench.engine.following import FOLLOWING_RANGE_M
from charms_bench.people.highd import LANE_WIDTH_M, Recording
from charms_bench.people.labels import LATERAL_SPEED_MPS
from charms_bench.people.situations import at_decisions
from charms_bench.world.lanes import NEIGHBOUR_MARGIN_M
from charms_bench.world.scene import Floats

DECISION_HZ = 3
"""The rate at which the simulation counts."""
_ON_LANE_M = LANE_WIDTH_M / 2 + NEIGHBOUR_MARGIN_M
"""A vehicle is on a lane while its centre is this near to the lane's; see `Scene.leader`."""


@dataclass(frozen=True)
class Followers:
    """Drivers with a leader within 50 m in their lane, centre to centre."""

    speed: Floats
    """Along the road, of each driver at each decision, m/s."""
    dhw: Floats
    """To the leader, at each start of a lane change, m."""
    vehicles: int
    """All that were recorded."""
    lane_changes: int
    """All that were recorded, with a leader or without."""


def followers(recordings: Iterable[Recording]) -> Followers:
    """Those of some recordings, trucks and both carriageways included.

    Raises:
        DataError: There are fewer frames than decisions.
    """
    speeds, headways, vehicles, lane_changes = [], [], 0, 0
    for recording in recordings:
        decided = recording.tracks.filter(at_decisions(recording, DECISION_HZ))
        speeds.append(_following(decided)["speed"].to_numpy())
        starts = lane_change_starts(recording)
        at_starts = recording.tracks.join(starts.select("frame").unique(), on="frame", how="semi")
        found = _following(at_starts).join(starts, on=["vehicle", "frame"], how="semi")
        headways.append(found["leader_distance"].to_numpy())
        vehicles += recording.tracks["vehicle"].n_unique()
        lane_changes += recording.lane_changes.height
    return Followers(np.concatenate(speeds), np.concatenate(headways), vehicles, lane_changes)


def lane_change_starts(recording: Recording) -> pl.DataFrame:
    """The vehicle and the frame in which each of its lane changes starts.

    A vehicle that moves sideways all through its stay, since it was first seen or since its last
    lane change, starts none there.
    """
    changes = recording.lane_changes.rename({"lane": "left", "frame": "first"})
    towards = (pl.col("next_lane") - pl.col("left")).sign() * pl.col("lateral_speed")
    return (
        recording.tracks.join(changes, on="vehicle")
        .filter(pl.col("frame").is_between("first", "last"), towards <= LATERAL_SPEED_MPS)
        .group_by("vehicle", "last")
        .agg(pl.col("frame").max())
        .select("vehicle", "frame")
        .sort("vehicle", "frame")
    )


def _following(tracks: pl.DataFrame) -> pl.DataFrame:
    """The rows on the road with a leader within 50 m, and the `leader_distance` to it."""
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
