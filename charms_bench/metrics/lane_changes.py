"""How often the ego changes lanes, and what that costs the follower on the new lane.

A lane change lies between two steps with different nearest lanes. MOBIL (Kesting et al. 2007,
eq. 2) calls a lane change safe if the new follower has to brake by at most a limit, which is
2 m/s2 in highway-env.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, Sample, in_name

SAFE_BRAKING_MPS2 = 2.0

IMPOSED = pl.col("imposed_braking_mps2")
IMPOSING = Sample("lane changes with a follower", IMPOSED.is_not_null())

LANE_CHANGES_PER_KM = Metric(
    name="lane_changes_per_km",
    unit="1/km",
    description="lane changes, per km driven",
    rests_on="steps",
    sums=(pl.first("steps"), pl.first("distance_m") / 1e3, pl.col("lane_changed").sum()),
    interval="rate",
)
IMPOSED_BRAKING_MEAN = IMPOSING.mean(
    "imposed_braking_mean",
    "m/s²",
    IMPOSED,
    "strongest braking of the new follower within 2 s of a lane change, mean",
)


def imposed_braking_above(limit_mps2: float) -> Metric:
    """The share of lane changes that make the new follower brake harder than the limit."""
    return IMPOSING.share(
        f"imposed_braking_above_{in_name(limit_mps2)}",
        IMPOSED.gt(limit_mps2),
        "share of lane changes within 2 s of which the new follower brakes by more "
        f"than {limit_mps2:g} m/s²",
    )
