"""How far behind its leader the ego drives.

Distance headway (DHW) is measured from centre to centre, and time headway from front to front;
between vehicles of one length these are the same distance. Beyond a headway of 6 s a driver is
free of the leader (Vogel 2003, Accident Analysis and Prevention 35).
"""

import polars as pl

from charms_bench.metrics.metric import (
    Metric,
    in_name,
    moments,
    ratio,
    standard_deviation,
    total,
)

FREE_HEADWAY_S = 6.0
SHORT_HEADWAY_S = 1.0

LOGGED = pl.col("logged")
DISTANCE = pl.col("leader_distance")
HEADWAY = pl.col("time_headway_s")
FOLLOWING = HEADWAY <= FREE_HEADWAY_S

DHW_MEAN = Metric(
    name="dhw_mean",
    unit="m",
    description="distance headway in logged steps",
    rests_on="logged steps",
    sums=(LOGGED.sum(), total(DISTANCE, LOGGED)),
    value=ratio,
)
DHW_STD = Metric(
    name="dhw_std",
    unit="m",
    description="standard deviation of the distance headway in logged steps",
    rests_on="logged steps",
    sums=moments(DISTANCE, LOGGED),
    value=standard_deviation,
)
TIME_HEADWAY_MEAN = Metric(
    name="time_headway_mean",
    unit="s",
    description="time headway while following, which is up to 6 s",
    rests_on="following steps",
    sums=(FOLLOWING.sum(), total(HEADWAY, FOLLOWING)),
    value=ratio,
)


def time_headway_below(threshold_s: float) -> Metric:
    """The share of time in which the ego is nearer in time to its leader."""
    return Metric(
        name=f"time_headway_below_{in_name(threshold_s)}s",
        unit="",
        description=f"share of time with a time headway below {threshold_s:g} s",
        rests_on="steps",
        sums=(pl.col("driving").sum(), HEADWAY.lt(threshold_s).sum()),
        value=ratio,
        interval="share",
    )


TIME_HEADWAY_BELOW_1S = time_headway_below(SHORT_HEADWAY_S)
