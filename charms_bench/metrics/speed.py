"""How fast the ego and the traffic drive."""

import polars as pl

from charms_bench.metrics.metric import Metric
from charms_bench.metrics.samples import LOGGED, Sample

SPEED = pl.col("speed")
VEHICLES = pl.first("traffic_vehicles")

PAPER_SPEED_MEAN = LOGGED.mean("speed_mean", "m/s", SPEED, "speed with a leader within 50 m")
PAPER_SPEED_STD = LOGGED.deviation("speed_std", "m/s", SPEED, "speed with a leader within 50 m")
TRAFFIC_SPEED_MEAN = Metric(
    name="traffic_speed_mean",
    unit="m/s",
    description="distance of the other vehicles divided by their time, including crashed vehicles",
    rests_on="vehicles",
    sums=(VEHICLES, VEHICLES * pl.first("duration_s"), pl.first("traffic_distance_m")),
)


def speed_mean(driving: Sample) -> Metric:
    """The mean speed of the ego."""
    return driving.mean("speed_mean", "m/s", SPEED, "speed of the ego")
