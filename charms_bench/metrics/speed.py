"""How fast the ego and the traffic drive."""

import polars as pl

from charms_bench.metrics.metric import Metric, moments, standard_deviation, total
from charms_bench.metrics.rows import DRIVING, LOGGED

SPEED = pl.col("speed")

PAPER_SPEED_MEAN = Metric(
    name="speed_mean",
    unit="m/s",
    description="speed in logged steps",
    rests_on="logged steps",
    sums=(LOGGED.sum(), total(SPEED, LOGGED)),
)
PAPER_SPEED_STD = Metric(
    name="speed_std",
    unit="m/s",
    description="standard deviation of the speed in logged steps",
    rests_on="logged steps",
    sums=moments(SPEED, LOGGED),
    value=standard_deviation,
)
SPEED_MEAN = Metric(
    name="speed_mean",
    unit="m/s",
    description="speed of the ego, up to a collision",
    rests_on="steps",
    sums=(DRIVING.sum(), total(SPEED, DRIVING)),
)
TRAFFIC_SPEED_MEAN = Metric(
    name="traffic_speed_mean",
    unit="m/s",
    description="distance over time of the other vehicles, wrecks included",
    rests_on="vehicles",
    sums=(
        pl.first("traffic_vehicles"),
        pl.first("traffic_vehicles") * pl.first("duration_s"),
        pl.first("traffic_distance_m"),
    ),
)
