"""How far behind its leader the ego drives.

Distance headway (DHW) is measured from centre to centre, and time headway from front to front;
between vehicles of one length these are the same distance. With a headway above 6 s, a driver
drives freely (Vogel 2003, Accident Analysis and Prevention 35).
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name
from charms_bench.metrics.samples import LOGGED, Sample

FREE_HEADWAY_S = 6.0
SHORT_HEADWAY_S = 1.0

DISTANCE = pl.col("leader_distance")
HEADWAY = pl.col("time_headway_s")

DHW_MEAN = LOGGED.mean("dhw_mean", "m", DISTANCE, "distance headway with a leader within 50 m")
DHW_STD = LOGGED.deviation("dhw_std", "m", DISTANCE, "distance headway with a leader within 50 m")


def time_headway_mean(driving: Sample) -> Metric:
    """The mean time headway while the ego follows a leader."""
    return driving.among("following steps", HEADWAY <= FREE_HEADWAY_S).mean(
        "time_headway_mean", "s", HEADWAY, "time headway while it is at most 6 s"
    )


def time_headway_below(driving: Sample, threshold_s: float) -> Metric:
    """The proportion of time in which the time headway is below a threshold."""
    return driving.share(
        f"time_headway_below_{in_name(threshold_s)}s",
        HEADWAY.lt(threshold_s),
        f"proportion of time with a time headway below {threshold_s:g} s",
    )
