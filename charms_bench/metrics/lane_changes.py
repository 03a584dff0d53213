"""How often the ego changes lanes, and what that costs the follower on the new lane.

A lane change lies between two steps with different nearest lanes. MOBIL (Kesting et al. 2007,
eq. 2) calls one safe that makes the new follower brake by no more than a limit; highway-env's
is 2 m/s2.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name, ratio

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


def imposed_braking_above(limit_mps2: float) -> Metric:
    """The share of lane changes that make the new follower brake harder than the limit."""
    return Metric(
        name=f"imposed_braking_above_{in_name(limit_mps2)}",
        unit="",
        description="share of lane changes within 2 s of which the new follower brakes by more "
        f"than {limit_mps2:g} m/s²",
        rests_on="lane changes with a follower",
        sums=(IMPOSED.count(), IMPOSED.gt(limit_mps2).sum()),
        value=ratio,
        interval="share",
    )


IMPOSED_BRAKING_ABOVE_2 = imposed_braking_above(SAFE_BRAKING_MPS2)
