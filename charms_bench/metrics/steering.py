"""How steadily the ego steers."""

import polars as pl

from charms_bench.metrics.metric import Metric, moments, standard_deviation
from charms_bench.metrics.rows import LOGGED

PAPER_YAW_STD = Metric(
    name="yaw_std",
    unit="rad",
    description="standard deviation of the steering angle in logged steps",
    rests_on="logged steps",
    sums=moments(pl.col("steering"), LOGGED),
    value=standard_deviation,
)
