"""How often the ego changes lanes, and what that costs the follower on the new lane.

A lane change lies between two steps with different nearest lanes. MOBIL (Kesting et al. 2007,
eq. 2) calls a lane change safe if the new follower has to brake by at most a limit, which is
2 m/s2 in highway-env.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name

SAFE_BRAKING_MPS2 = 2.0

IMPOSED = pl.col("imposed_braking_mps2")

LANE_CHANGES_PER_KM = Metric(
    name="lane_changes_per_km",
    unit="1/km",
    description="lane changes, per km driven",
    rests_on="episodes",
    sums=(pl.lit(1), pl.first("distance_m") / 1e3, pl.col("lane_changed").sum()),
    interval="rate",
)
IMPOSED_BRAKING_MEAN = Metric(
    name="imposed_braking_mean",
    unit="m/s²",
    description="strongest braking of the new follower within 2 s of a lane change, mean",
    rests_on="lane changes with a follower",
    sums=(IMPOSED.count(), IMPOSED.sum()),
)


def imposed_braking_above(limit_mps2: float) -> Metric:
    """The share of lane changes that make the new follower brake harder than the limit."""
    return Metric(
        name=f"imposed_braking_above_{in_name(limit_mps2)}",
        unit="",
        description="share of lane changes within 2 s of which the new follower brakes by more "
        f"than {limit_mps2:g} m/s²",
        rests_on="lane changes with a follower",
        sums=(IMPOSED.count(), IMPOSED.gt(limit_mps2).sum()),
        interval="share",
    )
