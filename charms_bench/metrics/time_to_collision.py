"""How near in time the ego comes to hitting its leader.

Sources: Hayward 1972 for time to collision (TTC); Minderhoud & Bovy 2001 (Accident Analysis and
Prevention 33) for time exposed (TET) and time integrated (TIT) TTC; Gettman & Head 2003 (FHWA's
Surrogate Safety Assessment Model) for the 1.5 s below which a TTC is a conflict.
"""

import polars as pl

from charms_bench.metrics.metric import Metric, ratio, total

TTC_THRESHOLD_S = 3.0
"""Also the horizon of the paper's safety reward."""
CONFLICT_TTC_S = 1.5
TTC_CAP_S = 100.0
"""In the paper's logs; a longer one says nothing of danger and would rule any mean."""

LOGGED = pl.col("logged")
CLOSING = LOGGED & (pl.col("speed") > pl.col("leader_speed"))
PAPER_TTC = (
    pl.when(CLOSING)
    .then(pl.col("leader_distance") / (pl.col("speed") - pl.col("leader_speed")))
    .otherwise(TTC_CAP_S)
    .clip(upper_bound=TTC_CAP_S)
)
DRIVING = pl.col("driving")
TTC = pl.col("ttc_s")
HAS_TTC = TTC.is_not_null().any()
EXPOSED = TTC < TTC_THRESHOLD_S

PAPER_TTC_BELOW_3S = Metric(
    name="ttc_below_3s",
    unit="",
    description="share of logged steps with a centre-to-centre TTC below 3 s",
    rests_on="logged steps",
    sums=(LOGGED.sum(), (LOGGED & (PAPER_TTC < TTC_THRESHOLD_S)).sum()),
    value=ratio,
    interval="share",
)
PAPER_TTC_BELOW_3S_CLOSING = Metric(
    name="ttc_below_3s_closing",
    unit="",
    description="share with a centre-to-centre TTC below 3 s among the logged steps in which the "
    "ego is faster than its leader",
    rests_on="closing steps",
    sums=(CLOSING.sum(), (CLOSING & (PAPER_TTC < TTC_THRESHOLD_S)).sum()),
    value=ratio,
    interval="share",
)
TTC_BELOW_3S = Metric(
    name="ttc_below_3s",
    unit="",
    description="share of time with a bumper-to-bumper TTC below 3 s",
    rests_on="steps",
    sums=(DRIVING.sum(), EXPOSED.sum()),
    value=ratio,
    interval="share",
)
TTC_MIN = Metric(
    name="ttc_min",
    unit="s",
    description="smallest bumper-to-bumper TTC of an episode, at most 100 s: mean over the "
    "episodes in which the ego closes in on a leader",
    rests_on="episodes with a closing leader",
    sums=(HAS_TTC, TTC.min().clip(upper_bound=TTC_CAP_S)),
    value=ratio,
)
CONFLICT_EPISODES = Metric(
    name="conflict_episodes",
    unit="",
    description="share of episodes in which the bumper-to-bumper TTC falls below 1.5 s",
    rests_on="episodes",
    sums=(pl.lit(1), (TTC < CONFLICT_TTC_S).any()),
    value=ratio,
    interval="wilson",
)
TET = Metric(
    name="tet",
    unit="s",
    description="time exposed TTC: time in an episode with a TTC below 3 s, mean",
    rests_on="episodes",
    sums=(pl.lit(1), total(pl.col("interval_s"), EXPOSED)),
    value=ratio,
)
TIT = Metric(
    name="tit",
    unit="s²",
    description="time integrated TTC: 3 s less TTC, over the time in an episode in which that "
    "is positive, mean",
    rests_on="episodes",
    sums=(pl.lit(1), total((TTC_THRESHOLD_S - TTC) * pl.col("interval_s"), EXPOSED)),
    value=ratio,
)
