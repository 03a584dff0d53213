"""How fast the ego and the traffic drive, and how smoothly the ego accelerates, brakes and steers.

Accelerations are those commanded in the last step of each decision.
"""

import polars as pl

from charms_bench.metrics.metric import Metric
from charms_bench.metrics.row_samples import Sample
from charms_bench.world.thresholds import HARSH_MPS2

SPEED = pl.col("speed")
ACCELERATION = pl.col("acceleration")
HARSH = ACCELERATION.abs() > HARSH_MPS2
JERK = pl.col("jerk_mps3")
YAW_RATE = pl.col("yaw_rate_radps")
VEHICLES = pl.first("traffic_vehicles")
TRAFFIC_SPEED_MEAN = Metric(
    name="traffic_speed_mean",
    unit="m/s",
    description="distance of the other vehicles divided by their time, including crashed vehicles",
    rests_on="vehicles",
    sums=(
        VEHICLES,
        pl.coalesce(pl.first("traffic_time_s"), VEHICLES * pl.first("duration_s")),
        pl.first("traffic_distance_m"),
    ),
)


def of_motion(driving: Sample) -> tuple[Metric, ...]:
    """The mean speed, the spread and harshness of the acceleration, the jerk and the yaw rate."""
    return (
        driving.mean("speed_mean", "m/s", SPEED, "speed of the ego"),
        driving.deviation("acc_std", "m/s²", ACCELERATION, "acceleration"),
        driving.proportion(
            "harsh_acc_rate",
            HARSH,
            "proportion of time in which the ego accelerates or brakes by more than 2.5 m/s²",
        ),
        driving.among("pairs of steps", JERK.is_not_null()).root_mean_square(
            "jerk_rms",
            "m/s³",
            JERK,
            "change of acceleration between two decisions, divided by their interval",
        ),
        driving.among("pairs of steps", YAW_RATE.is_not_null()).root_mean_square(
            "yaw_rate_rms",
            "rad/s",
            YAW_RATE,
            "change of heading between two decisions, divided by their interval",
        ),
    )
