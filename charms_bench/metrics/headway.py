"""How far behind its leader the ego drives.

Distance headway (DHW) is measured from centre to centre, and time headway from front to front;
between vehicles of one length these are the same distance. Beyond a headway of 6 s a driver is
free of the leader (Vogel 2003, Accident Analysis and Prevention 35).
"""

import polars as pl

from charms_bench.metrics.metric import Metric, moments, ratio, standard_deviation, total

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
TIME_HEADWAY_BELOW_1S = Metric(
    name="time_headway_below_1s",
    unit="",
    description="share of time with a time headway below 1 s",
    rests_on="steps",
    sums=(pl.col("driving").sum(), (HEADWAY < SHORT_HEADWAY_S).sum()),
    value=ratio,
    interval="share",
)
