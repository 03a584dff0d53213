"""How often the ego changes lanes, in which gaps, how fast, and what that costs the new follower.

A lane change lies between two decisions with different nearest lanes. The accepted gaps are those
between the bumpers at the second of them: the lead gap to the leader on the new lane, the lag gap
to the follower (Yang 1997). MOBIL (Kesting et al. 2007, eq. 2) calls a lane change safe if the new
follower has to brake by at most a limit, which is 2 m/s2 in highway-env.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name
from charms_bench.metrics.row_samples import Sample
from charms_bench.metrics.rows import UNDONE_WITHIN_S

CHANGED, UNDONE = pl.col("lane_changed"), pl.col("undone")
IMPOSED = pl.col("imposed_braking_mps2")
LEAD_GAP, LAG_GAP = pl.col("lead_gap_m"), pl.col("lag_gap_m")
MOVEMENT, CHANGES = pl.col("movement_s"), pl.col("movement_changes")


def of_lane_changes(driving: Sample, limit_mps2: float) -> tuple[Metric, ...]:
    """The rate and duration of lane changes, their gaps, and the braking that they impose."""
    ended = driving.among("finished lane changes", CHANGES.is_not_null())
    imposing = driving.among("lane changes with a follower", IMPOSED.is_not_null())
    return (
        driving.per_km("lane_changes_per_km", CHANGED, "lane changes"),
        driving.among("lane changes", CHANGED).proportion(
            "lane_changes_undone",
            UNDONE,
            f"proportion of lane changes of which the next leads back within {UNDONE_WITHIN_S:g} s",
        ),
        Metric(
            name="lane_change_duration_mean",
            unit="s",
            description="time from start to end of the lateral movement (faster than 0.1 m/s) per "
            "lane change: mean over the movements that end within the episode",
            rests_on=ended.name,
            sums=(ended.only(CHANGES).sum(), ended.only(MOVEMENT).sum()),
        ),
        driving.among("lane changes with a leader", LEAD_GAP.is_not_null()).mean(
            "lead_gap_mean",
            "m",
            LEAD_GAP,
            "gap from the ego's front to the new leader's rear when the ego's nearest lane changes",
        ),
        driving.among("lane changes with a follower", LAG_GAP.is_not_null()).mean(
            "lag_gap_mean",
            "m",
            LAG_GAP,
            "gap from the ego's rear to the new follower's front when the ego's nearest lane "
            "changes",
        ),
        imposing.mean(
            "imposed_braking_mean",
            "m/s²",
            IMPOSED,
            "strongest braking of the new follower within 2 s after a lane change",
        ),
        imposing.proportion(
            f"imposed_braking_above_{in_name(limit_mps2)}",
            IMPOSED.gt(limit_mps2),
            "proportion of lane changes after which the new follower brakes by more than "
            f"{limit_mps2:g} m/s² within 2 s",
        ),
    )
