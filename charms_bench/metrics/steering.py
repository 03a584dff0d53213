"""How steadily the ego steers."""

import polars as pl

from charms_bench.metrics.rows import LOGGED

PAPER_YAW_STD = LOGGED.deviation(
    "yaw_std", "rad", pl.col("steering"), "steering angle in logged steps"
)
