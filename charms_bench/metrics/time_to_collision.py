"""How close in time the ego comes to hitting its leader, and its follower to hitting the ego.

Sources: Hayward 1972 for time to collision (TTC); Minderhoud & Bovy 2001 (Accident Analysis and
Prevention 33) for time exposed (TET) and time integrated (TIT) TTC.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name, per_episode, total
from charms_bench.metrics.samples import LOGGED, Sample

TTC_THRESHOLD_S = 3.0
"""Also the horizon of the paper's safety reward."""
TTC_CAP_S = 100.0
"""The paper's logs have this cap; a longer TTC is harmless, but would dominate any mean."""

CLOSING = LOGGED.among("closing steps", pl.col("speed") > pl.col("leader_speed"))
PAPER_TTC = (
    pl.when(CLOSING.where)
    .then(pl.col("leader_distance") / (pl.col("speed") - pl.col("leader_speed")))
    .otherwise(TTC_CAP_S)
    .clip(upper_bound=TTC_CAP_S)
)
TTC = pl.col("ttc_s")
REAR_TTC = pl.col("rear_ttc_s")

PAPER_TTC_BELOW_3S = LOGGED.share(
    "ttc_below_3s",
    PAPER_TTC < TTC_THRESHOLD_S,
    "proportion with a centre-to-centre TTC below 3 s among the decisions with a leader within "
    "50 m",
)
PAPER_TTC_BELOW_3S_CLOSING = CLOSING.share(
    "ttc_below_3s_closing",
    PAPER_TTC < TTC_THRESHOLD_S,
    "proportion with a centre-to-centre TTC below 3 s among the decisions with a leader within "
    "50 m in which the ego is faster than its leader",
)


def ttc_min(driving: Sample) -> Metric:
    """The smallest TTC of an episode, mean over episodes."""
    ttc = driving.only(TTC)
    return per_episode(
        "ttc_min",
        "s",
        ttc.min().clip(upper_bound=TTC_CAP_S),
        "smallest bumper-to-bumper TTC of an episode, at most 100 s: mean over the episodes in "
        "which the ego closes in on a leader",
        rests_on="episodes with a TTC",
        counts=ttc.is_not_null().any(),
    )


def ttc_below(driving: Sample, threshold_s: float) -> Metric:
    """The proportion of time in which the TTC is below a threshold."""
    return driving.share(
        f"ttc_below_{in_name(threshold_s)}s",
        TTC.lt(threshold_s),
        f"proportion of time with a bumper-to-bumper TTC below {threshold_s:g} s",
    )


def rear_ttc_below(driving: Sample, threshold_s: float) -> Metric:
    """The proportion of time in which the follower's TTC with the ego is below a threshold."""
    return driving.share(
        f"rear_ttc_below_{in_name(threshold_s)}s",
        REAR_TTC.lt(threshold_s),
        f"proportion of time with a bumper-to-bumper TTC of the follower below {threshold_s:g} s",
    )


def time_exposed(driving: Sample, threshold_s: float) -> Metric:
    """TET, the time per episode with a TTC below a threshold (Minderhoud & Bovy 2001)."""
    return Metric(
        name="tet",
        unit="s",
        description=f"time exposed TTC: mean time in an episode with a TTC below {threshold_s:g} s",
        rests_on="steps",
        # Steps, episodes per second of a step, and exposed steps: a rate of correlated events.
        sums=(
            driving.where.sum(),
            1 / pl.first("interval_s"),
            (driving.where & TTC.lt(threshold_s)).sum(),
        ),
        interval="rate",
    )


def time_integrated(driving: Sample, threshold_s: float) -> Metric:
    """TIT, the shortfall of the TTC below a threshold over time (Minderhoud & Bovy 2001)."""
    return per_episode(
        "tit",
        "s²",
        total((threshold_s - TTC) * pl.col("interval_s"), driving.where & TTC.lt(threshold_s)),
        f"time integrated TTC: {threshold_s:g} s minus the TTC, integrated over the time in which "
        "this is positive, mean over the episodes",
    )
