"""How often the ego comes into conflict with any vehicle around it, ahead, beside or behind.

A planar conflict lasts while the planar TTC (`engine.planar_ttc`) is below a threshold, 1.5 s by
default (Gettman et al. 2008, FHWA's Surrogate Safety Assessment Model). It begins at the first such
decision, with whichever vehicle.
"""

import polars as pl

from charms_bench.engine.planar_ttc import HORIZON_S
from charms_bench.metrics.metric import Metric, per_episode
from charms_bench.metrics.samples import Sample

PLANAR_TTC = pl.col("planar_ttc")


def planar_conflict_episodes(driving: Sample, threshold_s: float) -> Metric:
    """The proportion of episodes with a planar conflict."""
    return per_episode(
        "planar_conflict_episodes",
        "",
        driving.only(PLANAR_TTC.lt(threshold_s)).any(),
        f"proportion of episodes in which the planar TTC falls below {threshold_s:g} s",
        interval="wilson",
    )


def planar_conflicts_per_1000km(driving: Sample, threshold_s: float) -> Metric:
    """The rate of planar conflicts."""
    close = PLANAR_TTC.lt(threshold_s).fill_null(False)
    return driving.per_km(
        "planar_conflicts_per_1000km",
        close & ~close.shift(fill_value=False),
        f"number of times that the planar TTC falls below {threshold_s:g} s",
        km=1000,
    )


def planar_ttc_min(driving: Sample) -> Metric:
    """The smallest planar TTC of an episode, mean over episodes."""
    counts = driving.where.any()
    smallest = driving.only(PLANAR_TTC).min().fill_null(HORIZON_S)
    return per_episode(
        "planar_ttc_min",
        "s",
        pl.when(counts).then(smallest),
        f"smallest planar TTC of an episode, {HORIZON_S:g} s if it is never smaller: mean over the "
        "episodes with steps after the warm-up",
        rests_on="episodes with steps after the warm-up",
        counts=counts,
    )
