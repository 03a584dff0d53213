"""How often the ego changes lanes, in which gaps, how fast, and what that costs the new follower.

A lane change lies between two decisions with different nearest lanes. The accepted gaps are those
between the bumpers at the second of them: the lead gap to the leader on the new lane, the lag gap
to the follower (Yang 1997). MOBIL (Kesting et al. 2007, eq. 2) calls a lane change safe if the new
follower has to brake by at most a limit, which is 2 m/s2 in highway-env.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name
from charms_bench.metrics.samples import Sample

IMPOSED = pl.col("imposed_braking_mps2")
LEAD_GAP, LAG_GAP = pl.col("lead_gap_m"), pl.col("lag_gap_m")
MOVEMENT, CHANGES = pl.col("movement_s"), pl.col("movement_changes")


def lane_changes_per_km(driving: Sample) -> Metric:
    """The rate of lane changes."""
    return driving.per_km("lane_changes_per_km", pl.col("lane_changed"), "lane changes")


def lane_change_duration_mean(driving: Sample) -> Metric:
    """The mean duration of lane changes that end before the episode does."""
    ended = driving.among("finished lane changes", CHANGES.is_not_null())
    return Metric(
        name="lane_change_duration_mean",
        unit="s",
        description="time from start to end of the lateral movement (faster than 0.1 m/s) per lane "
        "change: mean over the movements that end within the episode",
        rests_on=ended.name,
        sums=(ended.only(CHANGES).sum(), ended.only(MOVEMENT).sum()),
    )


def lead_gap_mean(driving: Sample) -> Metric:
    """The mean gap to the new leader."""
    return driving.among("lane changes with a leader", LEAD_GAP.is_not_null()).mean(
        "lead_gap_mean",
        "m",
        LEAD_GAP,
        "gap from the ego's front to the new leader's rear when the ego's nearest lane changes",
    )


def lag_gap_mean(driving: Sample) -> Metric:
    """The mean gap to the new follower."""
    return driving.among("lane changes with a follower", LAG_GAP.is_not_null()).mean(
        "lag_gap_mean",
        "m",
        LAG_GAP,
        "gap from the ego's rear to the new follower's front when the ego's nearest lane changes",
    )


def _imposing(driving: Sample) -> Sample:
    return driving.among("lane changes with a follower", IMPOSED.is_not_null())


def imposed_braking_mean(driving: Sample) -> Metric:
    """The mean braking that lane changes impose on the new follower."""
    return _imposing(driving).mean(
        "imposed_braking_mean",
        "m/s²",
        IMPOSED,
        "strongest braking of the new follower within 2 s after a lane change",
    )


def imposed_braking_above(driving: Sample, limit_mps2: float) -> Metric:
    """The proportion of lane changes that make the new follower brake harder than the limit."""
    return _imposing(driving).share(
        f"imposed_braking_above_{in_name(limit_mps2)}",
        IMPOSED.gt(limit_mps2),
        "proportion of lane changes after which the new follower brakes by more than "
        f"{limit_mps2:g} m/s² within 2 s",
    )
