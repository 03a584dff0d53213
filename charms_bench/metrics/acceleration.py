"""How smoothly the ego accelerates and brakes, as commanded in the last step of each decision."""

import polars as pl

from charms_bench.metrics.metric import Metric, moments, root_mean_square, standard_deviation, total
from charms_bench.metrics.rows import DRIVING, LOGGED

HARSH_MPS2 = 2.5

ACCELERATION = pl.col("acceleration")
ACCELERATING = LOGGED & (ACCELERATION > 0)
JERK = pl.col("jerk_mps3")

PAPER_ACC_MEAN = Metric(
    name="acc_mean",
    unit="m/s²",
    description="acceleration in the logged steps in which it is positive",
    rests_on="accelerating steps",
    sums=(ACCELERATING.sum(), total(ACCELERATION, ACCELERATING)),
)
PAPER_ACC_STD = Metric(
    name="acc_std",
    unit="m/s²",
    description="standard deviation of the acceleration in logged steps",
    rests_on="logged steps",
    sums=moments(ACCELERATION, LOGGED),
    value=standard_deviation,
)
PAPER_HARSH_ACC_RATE = Metric(
    name="harsh_acc_rate",
    unit="",
    description="share of logged steps with more than 2.5 m/s², accelerating or braking",
    rests_on="logged steps",
    sums=(LOGGED.sum(), (LOGGED & (ACCELERATION.abs() > HARSH_MPS2)).sum()),
    interval="share",
)
ACC_STD = Metric(
    name="acc_std",
    unit="m/s²",
    description="standard deviation of the acceleration, up to a collision",
    rests_on="steps",
    sums=moments(ACCELERATION, DRIVING),
    value=standard_deviation,
)
JERK_RMS = Metric(
    name="jerk_rms",
    unit="m/s³",
    description="root mean square of the change of acceleration between decisions over the "
    "decision interval, up to a collision",
    rests_on="pairs of steps",
    sums=(JERK.count(), JERK.pow(2).sum()),
    value=root_mean_square,
)
