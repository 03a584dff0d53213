"""How steadily the ego steers."""

import polars as pl

from charms_bench.metrics.metric import Metric, moments, standard_deviation

PAPER_YAW_STD = Metric(
    name="yaw_std",
    unit="rad",
    description="standard deviation of the steering angle in logged steps",
    rests_on="logged steps",
    sums=moments(pl.col("steering"), pl.col("logged")),
    value=standard_deviation,
)
