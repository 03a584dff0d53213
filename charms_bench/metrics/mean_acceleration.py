"""How smoothly the ego's speed changes: its mean acceleration over each decision interval.

The mean acceleration is the change of speed between two decisions, divided by their interval. So it
is what a recording shows of a driver, whatever was commanded within the interval.
"""

import polars as pl

from charms_bench.metrics.metric import Metric
from charms_bench.metrics.row_samples import Sample

STRONG_MPS2 = 1.1
"""Recorded drivers on I-24 and I-75 exceed it in about 1 % of decisions."""
REVERSAL_MPS2 = 0.3
"""Smaller mean accelerations are neither speeding up nor slowing down."""
MEAN_ACCELERATION = pl.col("mean_acceleration_mps2")


def of_mean_acceleration(driving: Sample, strong_mps2: float) -> tuple[Metric, ...]:
    """The spread of the mean acceleration, how often it is strong, and its reversals."""
    intervals = driving.among("pairs of steps", MEAN_ACCELERATION.is_not_null())
    acceleration = driving.only(MEAN_ACCELERATION)
    # An episode's rows are aggregated by themselves, so this sees no other episode.
    direction = (
        pl.when(acceleration > REVERSAL_MPS2).then(1).when(acceleration < -REVERSAL_MPS2).then(-1)
    )
    reverses = (direction * direction.forward_fill().shift() < 0).fill_null(False)
    return (
        intervals.deviation(
            "mean_acceleration_std",
            "m/s²",
            MEAN_ACCELERATION,
            "change of speed between two decisions, divided by their interval (mean acceleration)",
        ),
        intervals.proportion(
            "strong_acceleration_rate",
            MEAN_ACCELERATION.abs().gt(strong_mps2),
            "proportion of the intervals between two decisions with a mean acceleration above "
            f"{strong_mps2:g} m/s² either way",
        ),
        intervals.per_minute(
            "acceleration_reversals_per_min",
            reverses,
            f"changes of the mean acceleration from above {REVERSAL_MPS2:g} m/s² to below "
            f"-{REVERSAL_MPS2:g} m/s², or back",
        ),
    )
