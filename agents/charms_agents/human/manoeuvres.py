"""Intents from what a recorded driver goes on to do, instead of from one moment.

A lateral movement that ends in another lane is a lane change from its onset until the marking is
crossed; afterwards, the same meta-action would ask for one lane further. A movement is a run of
frames in which the vehicle moves to the same side faster than `LATERAL_SPEED_MPS`. Drifts that end
in no other lane are none. Speed intents follow from the mean acceleration of the next 2 s.
"""

import polars as pl

from charms_agents.human.soft_labels import LATERAL_SPEED_MPS
from charms_bench.world.trajectories import Recording

AHEAD_S = 2.0


def manoeuvres(recording: Recording) -> pl.DataFrame:
    """Columns direction, vehicle and frame, one row per row of `Recording.tracks`, and these.

    movement: 1 during a lane change to the right, -1 to the left, otherwise 0.
    mean_acceleration: Over the next `AHEAD_S`, or until the vehicle leaves the recording, m/s2.
    """
    vehicle = ["direction", "vehicle"]
    rows = recording.tracks.sort(*vehicle, "frame")
    ahead = round(AHEAD_S * recording.frame_rate_hz)

    def later(name: str) -> pl.Expr:
        return pl.col(name).shift(-ahead).fill_null(pl.col(name).last()).over(vehicle)

    elapsed_s = (later("frame") - pl.col("frame")) / recording.frame_rate_hz
    gained = later("speed") - pl.col("speed")
    side = pl.col("lateral_speed").sign() * (pl.col("lateral_speed").abs() > LATERAL_SPEED_MPS)
    next_lane = pl.col("lane").shift(-1).fill_null(pl.col("lane")).over(vehicle)
    crosses = (pl.col("side") != 0) & ((next_lane - pl.col("lane")).sign() == pl.col("side"))
    return (
        rows.with_columns(side=side.cast(pl.Int8))
        .with_columns(run=pl.col("side").rle_id(), crosses=crosses)
        .select(
            *vehicle,
            "frame",
            # A run reaches up to its last crossing.
            movement=pl.col("side")
            * (pl.col("crosses") & (pl.col("side") != 0))
            .cum_max(reverse=True)
            .over(*vehicle, "run"),
            mean_acceleration=pl.when(elapsed_s > 0)
            .then(gained / elapsed_s)
            .otherwise("acceleration"),
        )
    )
