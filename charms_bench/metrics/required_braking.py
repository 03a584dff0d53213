"""How hard the ego would have to brake: the deceleration rate to avoid a crash (DRAC).

DRAC is the closing speed squared over twice the bumper gap (Cooper & Ferguson 1976); above
3.35 m/s2, a driver cannot be relied on to brake hard enough (Archer 2005).
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name, per_episode
from charms_bench.metrics.row_samples import Sample

DRAC_CAP_MPS2 = 9.81
"""Tyres allow no more; DRAC grows without bounds just before a collision."""
DRAC = pl.col("drac_mps2")


def of_required_braking(driving: Sample, limit_mps2: float) -> tuple[Metric, ...]:
    """The largest DRAC, and the time above a limit."""
    drac = driving.only(DRAC)
    return (
        per_episode(
            "drac_max",
            "m/s²",
            drac.max().clip(upper_bound=DRAC_CAP_MPS2),
            "largest DRAC of an episode, at most 9.81 m/s²: mean over the episodes with a leader",
            rests_on="episodes with a leader",
            counts=drac.is_not_null().any(),
        ),
        driving.proportion(
            f"drac_above_{in_name(limit_mps2)}",
            DRAC.gt(limit_mps2),
            f"proportion of time with a DRAC above {limit_mps2:g} m/s²",
        ),
    )
