"""How close in time the ego comes to hitting its leader, and its follower to hitting the ego.

Sources: Hayward 1972 for time to collision (TTC); Minderhoud & Bovy 2001 (Accident Analysis and
Prevention 33) for time exposed (TET) and time integrated (TIT) TTC.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name, per_episode, total
from charms_bench.metrics.row_samples import Sample

TTC_THRESHOLD_S = 3.0
"""Also the horizon of the paper's safety reward."""
TTC_CAP_S = 100.0
"""The paper's logs have this cap; a longer TTC is harmless, but would dominate any mean."""

TTC = pl.col("ttc_s")
REAR_TTC = pl.col("rear_ttc_s")


def time_to_collision(gap_m: pl.Expr, closing_mps: pl.Expr) -> pl.Expr:
    """The time until a gap is closed at constant speeds, s; null unless it is closing."""
    return pl.when(closing_mps > 0).then(gap_m / closing_mps)


def of_time_to_collision(driving: Sample, threshold_s: float) -> tuple[Metric, ...]:
    """The smallest TTC, the times with a TTC below a threshold, TET and TIT."""
    ttc = driving.only(TTC)
    exposed = driving.where & TTC.lt(threshold_s)
    return (
        per_episode(
            "ttc_min",
            "s",
            ttc.min().clip(upper_bound=TTC_CAP_S),
            "smallest bumper-to-bumper TTC of an episode, at most 100 s: mean over the episodes in "
            "which the ego closes in on a leader",
            rests_on="episodes with a TTC",
            counts=ttc.is_not_null().any(),
        ),
        driving.proportion(
            f"ttc_below_{in_name(threshold_s)}s",
            TTC.lt(threshold_s),
            f"proportion of time with a bumper-to-bumper TTC below {threshold_s:g} s",
        ),
        driving.proportion(
            f"rear_ttc_below_{in_name(threshold_s)}s",
            REAR_TTC.lt(threshold_s),
            "proportion of time with a bumper-to-bumper TTC of the follower below "
            f"{threshold_s:g} s",
        ),
        Metric(
            name="tet",
            unit="s",
            description="time exposed TTC: mean time in an episode with a TTC below "
            f"{threshold_s:g} s",
            rests_on="steps",
            # Steps, episodes per second of a step, and exposed steps: a rate of correlated events.
            sums=(driving.where.sum(), 1 / pl.first("interval_s"), exposed.sum()),
            interval="rate",
        ),
        per_episode(
            "tit",
            "s²",
            total((threshold_s - TTC) * pl.col("interval_s"), exposed),
            f"time integrated TTC: {threshold_s:g} s minus the TTC, integrated over the time in "
            "which this is positive, mean over the episodes",
        ),
    )
