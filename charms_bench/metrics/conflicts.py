"""How often the ego comes into conflict, and whose manoeuvre began a conflict with its leader.

A conflict with a leader lasts while the TTC is below a threshold, 1.5 s by default (Gettman & Head
2003, FHWA's Surrogate Safety Assessment Model). It begins at the first such decision, and again
with another leader. A lane change began it if it gave the ego this leader within the last 2 s: the
ego's own, or another vehicle's into or out of the ego's lane. Otherwise the ego closed in.

A planar conflict, with a vehicle ahead, beside or behind, lasts while the planar TTC
(`recording.planar_ttc`) is below the threshold (Gettman et al. 2008, on the same model). It begins
at the first such decision, with whichever vehicle.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, per_episode, proportion_of_episodes
from charms_bench.metrics.row_samples import Sample
from charms_bench.metrics.rows import ANOTHER, EGO
from charms_bench.metrics.time_to_collision import TTC
from charms_bench.recording.planar_ttc import HORIZON_S

CHANGER = pl.col("changer")
PLANAR_TTC = pl.col("planar_ttc")


def _often(
    driving: Sample, kind: str, close: pl.Expr, begins: pl.Expr, ttc: str, threshold_s: float
) -> tuple[Metric, Metric]:
    """The proportion of episodes with conflicts of a kind, and their rate."""
    return (
        proportion_of_episodes(
            f"{kind}_episodes",
            driving.only(close).any(),
            f"proportion of episodes in which the {ttc} TTC is below {threshold_s:g} s",
        ),
        driving.per_km(
            f"{kind}s_per_1000km",
            begins,
            f"number of times that the {ttc} TTC falls below {threshold_s:g} s",
            km=1000,
        ),
    )


def of_conflicts(driving: Sample, threshold_s: float) -> tuple[Metric, ...]:
    """The episodes with conflicts, their rate, and their proportions by what began them."""
    is_below = TTC.lt(threshold_s)
    close = is_below.fill_null(False)
    begins = close & (pl.col("leader_changed") | ~close.shift(fill_value=False))
    conflicts = driving.among("conflicts", begins)
    return (
        *_often(driving, "conflict", is_below, begins, "bumper-to-bumper", threshold_s),
        conflicts.proportion(
            "conflicts_by_ego",
            CHANGER == EGO,
            "proportion of conflicts within 2 s after a lane change by which the ego got its "
            "leader",
        ),
        conflicts.proportion(
            "conflicts_by_another",
            CHANGER == ANOTHER,
            "proportion of conflicts within 2 s after another vehicle's lane change, into or out "
            "of the ego's lane, by which the ego got its leader",
        ),
        conflicts.proportion(
            "conflicts_by_closing_in",
            CHANGER == 0,
            "proportion of conflicts with a leader that the ego has had for longer than 2 s",
        ),
    )


def of_planar_conflicts(driving: Sample, threshold_s: float) -> tuple[Metric, ...]:
    """The episodes with planar conflicts, their rate, and the smallest planar TTC."""
    is_below, counts = PLANAR_TTC.lt(threshold_s), driving.where.any()
    close = is_below.fill_null(False)
    begins = close & ~close.shift(fill_value=False)
    smallest = driving.only(PLANAR_TTC).min().fill_null(HORIZON_S)
    return (
        *_often(driving, "planar_conflict", is_below, begins, "planar", threshold_s),
        per_episode(
            "planar_ttc_min",
            "s",
            pl.when(counts).then(smallest),
            f"smallest planar TTC of an episode, {HORIZON_S:g} s if it is never smaller: mean over "
            f"the episodes with {driving.name}",
            rests_on=f"episodes with {driving.name}",
            counts=counts,
        ),
    )
