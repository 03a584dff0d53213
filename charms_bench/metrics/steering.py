"""How steadily the ego steers."""

import polars as pl

from charms_bench.metrics.metric import Metric
from charms_bench.metrics.samples import LOGGED, Sample

YAW_RATE = pl.col("yaw_rate_radps")

PAPER_YAW_STD = LOGGED.deviation(
    "yaw_std", "rad", pl.col("steering"), "steering angle with a leader within 50 m"
)


def yaw_rate_rms(driving: Sample) -> Metric:
    """The root mean square of the yaw rate."""
    return driving.among("pairs of steps", YAW_RATE.is_not_null()).root_mean_square(
        "yaw_rate_rms",
        "rad/s",
        YAW_RATE,
        "change of heading between two decisions, divided by their interval",
    )
