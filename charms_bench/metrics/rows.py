"""The rows that metrics aggregate: a run's step rows, joined with their episodes' rows.

Surrogate measures of safety describe how a vehicle follows its leader. They need a gap between
two vehicles. So they are null without a leader, next to a leader that is changing lanes, and in the
step in which the ego collides, because highway-env moves a wreck from then on.
"""

from collections.abc import Sequence

import numpy as np
import polars as pl
import polars.selectors as cs

from charms_bench.engine.columns import NO_DRIVERS
from charms_bench.metrics.conduct import conduct_of
from charms_bench.metrics.metric import Metric, Sample
from charms_bench.world.scene import Floats, SceneSettings

LOGGED = Sample("logged steps", pl.col("logged"))
DRIVING = Sample("steps", pl.col("driving"))
LOGGED_RANGE_M = 50.0
"""The paper logs the steps with a leader within this distance, centre to centre."""
IMPOSED_BRAKING_WINDOW_S = 2.0
"""For this long after a lane change, the follower's braking is attributed to it."""


def join_rows(episodes: pl.DataFrame, steps: pl.DataFrame, settings: SceneSettings) -> pl.DataFrame:
    """The step rows, sorted by episode and step, with their episode's columns and these.

    logged: Whether a leader is within 50 m, centre to centre.
    driving: Whether the ego has not collided by the end of the step.
    interval_s: Time between two decisions.
    lane_changed: Whether the lane differs from that of the previous step.
    gap_m: Distance from the ego's front to the leader's rear; both are `vehicle_length_m` long.
    time_headway_s: Time from the leader's front to the ego's front at the ego's speed.
    ttc_s: Time to collision at constant speeds; null unless the ego closes in.
    drac_mps2: Deceleration that just avoids a collision; 0 unless the ego closes in.
    jerk_mps3: Change of the commanded acceleration since the previous decision.
    imposed_braking_mps2: In the step of a lane change, the strongest braking of the follower on
        the new lane within 2 s; 0 if it does not brake, null without a follower.
    """
    length = settings.profile.vehicle_length_m
    interval = 1.0 / settings.decision_hz
    window = max(1, round(IMPOSED_BRAKING_WINDOW_S * settings.decision_hz))
    distance, closing = pl.col("leader_distance"), pl.col("speed") - pl.col("leader_speed")
    collided = pl.col("ending").is_in(["rear_end", "side"]) & (pl.col("step") == pl.col("steps"))
    follower = pl.when(pl.col("driving")).then(pl.col("follower_acceleration"))
    strongest = pl.min_horizontal(follower.shift(-k).over("episode") for k in range(window))
    return (
        episodes.join(steps, on="episode", how="left")
        .sort("episode", "step")
        .with_columns(cs.float().cast(pl.Float64))
        .with_columns(
            logged=(distance <= LOGGED_RANGE_M).fill_null(False),
            driving=(pl.col("step").is_not_null() & ~collided).fill_null(False),
            interval_s=pl.lit(interval),
            lane_changed=(pl.col("lane").diff().over("episode") != 0).fill_null(False),
        )
        .with_columns(
            gap_m=pl.when(pl.col("driving") & (distance > length)).then(distance - length),
            jerk_mps3=pl.when(pl.col("driving")).then(
                pl.col("acceleration").diff().over("episode") / interval
            ),
            imposed_braking_mps2=pl.when(pl.col("lane_changed") & strongest.is_not_null()).then(
                pl.max_horizontal(-strongest, 0.0)
            ),
        )
        .with_columns(
            time_headway_s=pl.when(pl.col("gap_m").is_not_null() & (pl.col("speed") > 0)).then(
                distance / pl.col("speed")
            ),
            ttc_s=pl.when(closing > 0).then(pl.col("gap_m") / closing),
            drac_mps2=pl.when(pl.col("gap_m").is_not_null()).then(
                pl.when(closing > 0).then(closing**2 / (2 * pl.col("gap_m"))).otherwise(0.0)
            ),
        )
    )


def sums_by_episode(
    metrics: Sequence[Metric],
    episodes: pl.DataFrame,
    steps: pl.DataFrame,
    settings: SceneSettings,
    drivers: pl.DataFrame = NO_DRIVERS,
) -> list[Floats]:
    """The sums [E, k] of each metric, by episode.

    They are those of E episode rows (`columns.EPISODE`), their step rows (`columns.STEP`) and
    their driver rows (`columns.DRIVER`); see `join_rows` and `conduct.conduct_of`.
    """
    rows = join_rows(episodes, steps, settings).join(
        conduct_of(drivers), on="episode", how="left", maintain_order="left"
    )
    aggregations = [
        expression.cast(pl.Float64).fill_null(0.0).alias(f"{i}.{j}")
        for i, metric in enumerate(metrics)
        for j, expression in enumerate(metric.sums)
    ]
    table = rows.group_by("episode", maintain_order=True).agg(aggregations).drop("episode")
    columns = np.cumsum([len(metric.sums) for metric in metrics])[:-1]
    return np.split(table.to_numpy(), columns, axis=1)
