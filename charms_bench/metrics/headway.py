"""How far behind its leader the ego drives.

Distance headway (DHW) is measured from centre to centre, and time headway from front to front;
between vehicles of one length these are the same distance. With a headway above 6 s, a driver
drives freely (Vogel 2003, Accident Analysis and Prevention 35).
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name, moments, standard_deviation, total
from charms_bench.metrics.rows import DRIVING, LOGGED

FREE_HEADWAY_S = 6.0
SHORT_HEADWAY_S = 1.0

DISTANCE = pl.col("leader_distance")
HEADWAY = pl.col("time_headway_s")
FOLLOWING = HEADWAY <= FREE_HEADWAY_S

DHW_MEAN = Metric(
    name="dhw_mean",
    unit="m",
    description="distance headway in logged steps",
    rests_on="logged steps",
    sums=(LOGGED.sum(), total(DISTANCE, LOGGED)),
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
)


def time_headway_below(threshold_s: float) -> Metric:
    """The share of time in which the time headway is below a threshold."""
    return Metric(
        name=f"time_headway_below_{in_name(threshold_s)}s",
        unit="",
        description=f"share of time with a time headway below {threshold_s:g} s",
        rests_on="steps",
        sums=(DRIVING.sum(), HEADWAY.lt(threshold_s).sum()),
        interval="share",
    )
