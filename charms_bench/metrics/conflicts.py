"""How often the ego comes into conflict with its leader, and whose manoeuvre began the conflict.

A conflict with a leader lasts while the TTC is below a threshold, 1.5 s by default (Gettman & Head
2003, FHWA's Surrogate Safety Assessment Model). It begins at the first such decision, and again
with another leader. A lane change began it if it gave the ego this leader within the last 2 s: the
ego's own, or another vehicle's into or out of the ego's lane. Otherwise the ego closed in.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, per_episode
from charms_bench.metrics.rows import ANOTHER, EGO
from charms_bench.metrics.samples import Sample
from charms_bench.metrics.time_to_collision import TTC

CHANGER = pl.col("changer")


def _begins(threshold_s: float) -> pl.Expr:
    """Whether a conflict begins; only within the aggregation of an episode."""
    close = TTC.lt(threshold_s).fill_null(False)
    return close & (pl.col("leader_changed") | ~close.shift(fill_value=False))


def conflict_episodes(driving: Sample, threshold_s: float) -> Metric:
    """The proportion of episodes with a conflict."""
    return per_episode(
        "conflict_episodes",
        "",
        driving.only(TTC.lt(threshold_s)).any(),
        f"proportion of episodes in which the bumper-to-bumper TTC falls below {threshold_s:g} s",
        interval="wilson",
    )


def conflicts_per_1000km(driving: Sample, threshold_s: float) -> Metric:
    """The rate of conflicts."""
    return driving.per_km(
        "conflicts_per_1000km",
        _begins(threshold_s),
        f"number of times that the bumper-to-bumper TTC falls below {threshold_s:g} s",
        km=1000,
    )


def conflict_beginnings(driving: Sample, threshold_s: float) -> tuple[Metric, ...]:
    """The proportions of conflicts by the manoeuvre that began them."""
    conflicts = driving.among("conflicts", _begins(threshold_s))
    by_another = (
        "proportion of conflicts within 2 s after another vehicle's lane change, into or out of "
        "the ego's lane, by which the ego got its leader"
    )
    return (
        conflicts.share(
            "conflicts_by_ego",
            CHANGER == EGO,
            "proportion of conflicts within 2 s after a lane change by which the ego got its "
            "leader",
        ),
        conflicts.share("conflicts_by_another", CHANGER == ANOTHER, by_another),
        conflicts.share(
            "conflicts_by_closing_in",
            CHANGER == 0,
            "proportion of conflicts with a leader that the ego has had for longer than 2 s",
        ),
    )
