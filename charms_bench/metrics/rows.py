"""The rows that metrics aggregate: a run's step rows, joined with their episodes' rows.

Surrogate measures of safety describe how one vehicle follows another. They need a gap between the
two. So they are null without that vehicle, while one of the two changes lanes beside the other, and
in the step in which the ego collides, because highway-env moves a wreck from then on.
"""

from collections.abc import Sequence

import numpy as np
import polars as pl
import polars.selectors as cs

from charms_bench.metrics.conduct import conduct_of
from charms_bench.metrics.metric import Metric
from charms_bench.metrics.time_to_collision import time_to_collision
from charms_bench.recording.columns import NO_DRIVERS, keys_of
from charms_bench.world.gaps import gap_to, required_braking
from charms_bench.world.scene import Floats, SceneSettings

LOGGED_RANGE_M = 50.0
"""The paper logs the steps with a leader within this distance, centre to centre."""
LANE_CHANGE_WINDOW_S = 2.0
"""For this long after a lane change, a conflict is attributed to it."""
UNDONE_WITHIN_S = 5.0
"""A lane change is undone if the next one leads back to the lane that it left, within this time."""
DRIFT_MPS = 0.1
"""A vehicle whose lateral speed is at most this stays at its place in the lane."""
EGO, ANOTHER = 1, 2
"""Whose lane change gave the ego its leader; values of the column `changer`."""
IS_LATER = pl.col("step") > 1
"""Whether the row before is of the same episode."""


def join_rows(episodes: pl.DataFrame, steps: pl.DataFrame, settings: SceneSettings) -> pl.DataFrame:
    """The step rows, sorted by episode and step, with their episode's columns and these.

    time_s: Time since the episode began.
    interval_s: Time between two decisions.
    logged: Whether a leader is within 50 m, centre to centre.
    driving: Whether the ego has not collided by the end of the step.
    driven_m: Distance along the road since the previous decision.
    mean_acceleration_mps2: Change of the speed since the previous decision.
    jerk_mps3: Change of the commanded acceleration since the previous decision.
    yaw_rate_radps: Change of the heading since the previous decision.
    lane_changed: Whether the lane differs from that of the previous decision.
    leader_changed: Whether the ego has another leader than at the previous decision.
    changer: Whose lane change within the last 2 s gave the ego its leader, `EGO`, `ANOTHER` or 0.
    gap_m: Distance from the ego's front to the leader's rear.
    ttc_s: Time to collision at constant speeds; null unless the ego closes in.
    drac_mps2: Deceleration that just avoids a collision; 0 unless the ego closes in.
    time_headway_s: Time from the leader's front to the ego's front at the ego's speed.
    rear_ttc_s: Time to collision of the follower with the ego; null unless the follower closes in.
    undone: In the step of a lane change, whether the next one leads back within 5 s.
    lead_gap_m, lag_gap_m: In the step of a lane change, the gaps to the leader and to the follower
        on the new lane; 0 beside a vehicle.
    imposed_braking_mps2: In the step of a lane change, the strongest braking of the new follower
        within 2 s; 0 if it does not brake, null without a new follower.
    movement_s: In the step in which a lateral movement with a lane change ends, its duration.
    movement_changes: The lane changes in that movement.
    """
    rate = settings.decision_hz
    collided = pl.col("ending").is_in(["rear_end", "side"]) & (pl.col("step") == pl.col("steps"))
    lateral_mps = pl.col("speed") * pl.col("heading").sin()
    keys = keys_of(episodes)
    return (
        episodes.join(steps, on=keys, how="left")
        .sort(*keys, "step")
        .with_columns(cs.float().cast(pl.Float64))
        .with_columns(
            time_s=pl.col("step") / rate,
            interval_s=pl.lit(1.0 / rate),
            logged=(pl.col("leader_distance") <= LOGGED_RANGE_M).fill_null(False),
            driving=(pl.col("step").is_not_null() & ~collided).fill_null(False),
            driven_m=_change("x"),
            lane_changed=_change("lane").ne(0).fill_null(False),
            leader_changed=IS_LATER & pl.col("leader").ne_missing(pl.col("leader").shift()),
        )
        .with_columns(
            mean_acceleration_mps2=_while_driving(_change("speed") * rate),
            jerk_mps3=_while_driving(_change("acceleration") * rate),
            yaw_rate_radps=_while_driving(_change("heading") * rate),
            drifting=(pl.col("driving") & (lateral_mps.abs() > DRIFT_MPS)).fill_null(False),
        )
        .with_columns(**_following())
        .with_columns(**_lane_changes(settings, keys))
    )


def _change(column: str) -> pl.Expr:
    return pl.when(IS_LATER).then(pl.col(column).diff())


def _while_driving(value: pl.Expr) -> pl.Expr:
    return pl.when(pl.col("driving")).then(value)


def _gap(other: str) -> pl.Expr:
    """The gap between the bumpers of the ego and its leader or its follower, m."""
    lengths = pl.col("length"), pl.col(f"{other}_length")
    gap: pl.Expr = gap_to(pl.col(f"{other}_distance"), *lengths)
    return gap


def _following() -> dict[str, pl.Expr]:
    """The columns on the leader and the follower."""
    speed, distance = pl.col("speed"), pl.col("leader_distance")
    gap, rear_gap = (_while_driving(_gap(other)) for other in ("leader", "follower"))
    gap, rear_gap = (pl.when(each > 0).then(each) for each in (gap, rear_gap))
    closing, rear_closing = speed - pl.col("leader_speed"), pl.col("follower_speed") - speed
    fronts = distance + (pl.col("leader_length") - pl.col("length")) / 2
    required = pl.when(closing > 0).then(required_braking(gap, closing)).otherwise(0.0)
    return {
        "gap_m": gap,
        "ttc_s": time_to_collision(gap, closing),
        "drac_mps2": pl.when(gap.is_not_null()).then(required),
        "time_headway_s": pl.when(gap.is_not_null() & (speed > 0)).then(fronts / speed),
        "rear_ttc_s": time_to_collision(rear_gap, rear_closing),
    }


def _lane_changes(settings: SceneSettings, keys: Sequence[str]) -> dict[str, pl.Expr]:
    """The columns on lane changes, which lie between two decisions with different lanes."""
    window = max(1, round(LANE_CHANGE_WINDOW_S * settings.decision_hz))
    changed, drifting = pl.col("lane_changed"), pl.col("drifting")
    changer = (
        pl.when(~IS_LATER)
        .then(0)  # an episode does not inherit from the one before
        .when(changed)
        .then(EGO)
        .when(pl.col("leader_changed"))
        .then(ANOTHER)
    )
    # A movement ends in the episode in which it begins, so these may run on across episodes.
    count = changed.cast(pl.Int64).cum_sum()
    drifted = pl.when(IS_LATER).then(drifting.shift())
    begins = drifting & ~drifted.fill_null(False)
    began_s = pl.when(begins).then(pl.col("time_s")).forward_fill()
    changes = count - pl.when(begins).then(count - changed).forward_fill()
    ended = pl.col("driving") & ~drifting & drifted & (changes > 0)
    own = changed & pl.col("driving")
    next_change = {
        name: pl.when(own).then(pl.col(name)).shift(-1).backward_fill()
        for name in (*keys, "step", "lane")
    }
    is_back = pl.all_horizontal(next_change[key].eq(pl.col(key)) for key in keys)
    is_back &= next_change["lane"].eq(pl.col("lane").shift())
    within = round(UNDONE_WITHIN_S * settings.decision_hz)
    return {
        "undone": own & is_back & (next_change["step"] - pl.col("step") <= within),
        "changer": changer.forward_fill(window - 1).fill_null(0),
        "lead_gap_m": pl.when(changed).then(_gap("leader").clip(0.0)),
        "lag_gap_m": pl.when(changed).then(_gap("follower").clip(0.0)),
        "imposed_braking_mps2": pl.when(changed).then(
            (-pl.col("new_follower_acceleration")).clip(0.0)
        ),
        "movement_s": pl.when(ended).then(pl.col("time_s") - began_s),
        "movement_changes": pl.when(ended).then(changes),
    }


def sums_by_episode(
    metrics: Sequence[Metric],
    episodes: pl.DataFrame,
    steps: pl.DataFrame,
    settings: SceneSettings,
    drivers: pl.DataFrame = NO_DRIVERS,
    left_out: float = 0.0,
) -> list[Floats]:
    """The sums [E, k] of each metric, by episode.

    They are those of the episode rows (`columns.EPISODE`) of E episodes, their step rows
    (`columns.STEP`) and their driver rows (`columns.DRIVER`); see `join_rows` and
    `conduct.conduct_of`. Those of several egos of an episode are added, so that intervals resample
    episodes. The column `left_out` has how many concrete scenarios are left out per episode.
    """
    rows = join_rows(episodes.with_columns(left_out=pl.lit(left_out)), steps, settings).join(
        conduct_of(drivers), on=keys_of(episodes), how="left", maintain_order="left"
    )
    aggregations = [
        expression.cast(pl.Float64).fill_null(0.0).alias(f"{i}.{j}")
        for i, metric in enumerate(metrics)
        for j, expression in enumerate(metric.sums)
    ]
    keys = keys_of(episodes)
    table = rows.group_by(keys, maintain_order=True).agg(aggregations).drop(keys[1:])
    if len(keys) > 1:
        table = table.group_by("episode", maintain_order=True).sum()
    table = table.drop("episode")
    columns = np.cumsum([len(metric.sums) for metric in metrics])[:-1]
    return np.split(table.to_numpy(), columns, axis=1)
