"""How hard the ego would have to brake: the deceleration rate to avoid a crash (DRAC).

DRAC is the closing speed squared over twice the bumper gap (Cooper & Ferguson 1976); above
3.35 m/s2 a driver cannot be counted on to brake hard enough (Archer 2005).
"""

import polars as pl

from charms_bench.metrics.metric import Metric, ratio

DRAC_LIMIT_MPS2 = 3.35
DRAC_CAP_MPS2 = 9.81
"""What tyres allow; in the instant before a collision DRAC grows without bounds."""

DRAC = pl.col("drac_mps2")

DRAC_MAX = Metric(
    name="drac_max",
    unit="m/s²",
    description="largest DRAC of an episode, at most 9.81 m/s²: mean over the episodes with a "
    "leader",
    rests_on="episodes with a leader",
    sums=(DRAC.is_not_null().any(), DRAC.max().clip(upper_bound=DRAC_CAP_MPS2)),
    value=ratio,
)
DRAC_ABOVE_3_35 = Metric(
    name="drac_above_3_35",
    unit="",
    description="share of time with a DRAC above 3.35 m/s²",
    rests_on="steps",
    sums=(pl.col("driving").sum(), (DRAC > DRAC_LIMIT_MPS2).sum()),
    value=ratio,
    interval="share",
)
