"""How smoothly the ego accelerates and brakes, as commanded in the last step of each decision."""

import polars as pl

from charms_bench.metrics.metric import Metric
from charms_bench.metrics.samples import LOGGED, STEPS, Sample
from charms_bench.world.thresholds import HARSH_MPS2

ACCELERATION = pl.col("acceleration")
HARSH = ACCELERATION.abs() > HARSH_MPS2
ACCELERATING = LOGGED.among("accelerating steps", ACCELERATION > 0)
JERK = pl.col("jerk_mps3")

PAPER_ACC_MEAN = ACCELERATING.mean(
    "acc_mean", "m/s²", ACCELERATION, "mean of the positive accelerations with a leader within 50 m"
)
PAPER_ACC_STD = LOGGED.deviation(
    "acc_std", "m/s²", ACCELERATION, "acceleration with a leader within 50 m"
)
PAPER_HARSH_ACC_RATE = LOGGED.share(
    "harsh_acc_rate",
    HARSH,
    "proportion of the decisions with a leader within 50 m in which the ego accelerates or "
    "brakes by more than 2.5 m/s²",
)
PAPER_HARSH_ACC_RATE_ALL_STEPS = STEPS.share(
    "harsh_acc_rate_all_steps",
    HARSH,
    "proportion of all steps in which the ego accelerates or brakes by more than 2.5 m/s²",
)


def acc_std(driving: Sample) -> Metric:
    """The standard deviation of the acceleration."""
    return driving.deviation("acc_std", "m/s²", ACCELERATION, "acceleration")


def harsh_acc_rate(driving: Sample) -> Metric:
    """The proportion of time in which the ego accelerates or brakes harshly."""
    return driving.share(
        "harsh_acc_rate",
        HARSH,
        "proportion of time in which the ego accelerates or brakes by more than 2.5 m/s²",
    )


def jerk_rms(driving: Sample) -> Metric:
    """The root mean square of the jerk."""
    return driving.among("pairs of steps", JERK.is_not_null()).root_mean_square(
        "jerk_rms",
        "m/s³",
        JERK,
        "change of acceleration between two decisions, divided by their interval",
    )
