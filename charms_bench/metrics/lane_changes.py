"""How often the ego changes lanes, and what that costs the follower on the new lane.

A lane change lies between two steps with different nearest lanes. MOBIL (Kesting et al. 2007,
eq. 2) calls one safe that makes the new follower brake by no more than a limit; highway-env's
is 2 m/s2.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, ratio

SAFE_BRAKING_MPS2 = 2.0

IMPOSED = pl.col("imposed_braking_mps2")

LANE_CHANGES_PER_KM = Metric(
    name="lane_changes_per_km",
    unit="1/km",
    description="lane changes, per km driven",
    rests_on="episodes",
    sums=(pl.lit(1), pl.first("distance_m") / 1e3, pl.col("lane_changed").sum()),
    value=ratio,
    interval="rate",
)
IMPOSED_BRAKING_MEAN = Metric(
    name="imposed_braking_mean",
    unit="m/s²",
    description="strongest braking of the new follower within 2 s of a lane change, mean",
    rests_on="lane changes with a follower",
    sums=(IMPOSED.count(), IMPOSED.sum()),
    value=ratio,
)
IMPOSED_BRAKING_ABOVE_2 = Metric(
    name="imposed_braking_above_2",
    unit="",
    description="share of lane changes within 2 s of which the new follower brakes by more "
    "than 2 m/s²",
    rests_on="lane changes with a follower",
    sums=(IMPOSED.count(), (IMPOSED > SAFE_BRAKING_MPS2).sum()),
    value=ratio,
    interval="share",
)
