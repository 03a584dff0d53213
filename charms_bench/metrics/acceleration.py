"""How smoothly the ego accelerates and brakes, as commanded in the last step of each decision."""

import polars as pl

from charms_bench.metrics.metric import Metric, Sample, root_mean_square
from charms_bench.metrics.rows import DRIVING, LOGGED

HARSH_MPS2 = 2.5

ACCELERATION = pl.col("acceleration")
ACCELERATING = Sample("accelerating steps", LOGGED.where & (ACCELERATION > 0))
JERK = pl.col("jerk_mps3")

PAPER_ACC_MEAN = ACCELERATING.mean(
    "acc_mean", "m/s²", ACCELERATION, "acceleration in the logged steps in which it is positive"
)
PAPER_ACC_STD = LOGGED.deviation("acc_std", "m/s²", ACCELERATION, "acceleration in logged steps")
PAPER_HARSH_ACC_RATE = LOGGED.share(
    "harsh_acc_rate",
    ACCELERATION.abs() > HARSH_MPS2,
    "share of logged steps with more than 2.5 m/s², accelerating or braking",
)
ACC_STD = DRIVING.deviation("acc_std", "m/s²", ACCELERATION, "acceleration, up to a collision")
JERK_RMS = Metric(
    name="jerk_rms",
    unit="m/s³",
    description="root mean square of the change of acceleration between decisions over the "
    "decision interval, up to a collision",
    rests_on="pairs of steps",
    sums=(JERK.count(), JERK.pow(2).sum()),
    value=root_mean_square,
)
