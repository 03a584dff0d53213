"""How close each episode came to harm, as one number that ranks episodes.

Each measure x of an episode is scaled to x / (x + limit): 0 where nothing was measured, 0.5 at the
limit that the literature gives, always below 1.

    measure                                           limit
    1 / smallest TTC, bumper to bumper                1 / 1.5 s     Gettman & Head 2003
    largest DRAC                                      3.35 m/s2     Archer 2005
    strongest braking that a lane change of the ego   2 m/s2        highway-env's MOBIL
        imposes on the follower
    number of abandoned lane changes                  1

Criticality is the sum of the four scaled measures, plus 4 if the ego collided or left the road.
Every collision therefore ranks above every episode without one. Unlike the metrics of the set
`standard`, the measures have no warm-up: a near miss at the start of an episode is worth a look.
"""

from typing import Literal

import polars as pl

from charms_bench.metrics.rows import join_rows
from charms_bench.recording.lane_changes import is_given_up
from charms_bench.world.scene import SceneSettings
from charms_bench.world.thresholds import CONFLICT_TTC_S, DRAC_LIMIT_MPS2, HARD_BRAKING_MPS2

Kind = Literal["collision", "near-miss", "hard-braking", "abandoned-lane-change"]
COLLISION = 4.0
"""Added for a collision: the upper bound of the four scaled measures together."""

_TTC = pl.col("ttc_min_s")
_DRAC = pl.col("drac_max_mps2")
_BRAKING = pl.col("imposed_braking_mps2")
_ABANDONED = pl.col("abandoned_changes")
_COLLIDED = ~pl.col("ending").is_in(["time", "goal"])
_MEASURES: tuple[tuple[Kind, pl.Expr], ...] = (
    ("near-miss", CONFLICT_TTC_S / (_TTC + CONFLICT_TTC_S)),
    ("near-miss", _DRAC / (_DRAC + DRAC_LIMIT_MPS2)),
    ("hard-braking", _BRAKING / (_BRAKING + HARD_BRAKING_MPS2)),
    ("abandoned-lane-change", _ABANDONED / (_ABANDONED + 1.0)),
)

IS_OF_KIND: dict[Kind, pl.Expr] = {
    "collision": _COLLIDED,
    "near-miss": ~_COLLIDED & ((_TTC < CONFLICT_TTC_S) | (_DRAC > DRAC_LIMIT_MPS2)),
    "hard-braking": _BRAKING > HARD_BRAKING_MPS2,
    "abandoned-lane-change": pl.col("gaps_lost") > 0,
}
"""Selects rows of `edge_cases.ranked` of a kind; an episode may be of several kinds."""


def criticality(
    episodes: pl.DataFrame, steps: pl.DataFrame, settings: SceneSettings, since: int = 1
) -> pl.DataFrame:
    """Returns one row per episode, sorted by episode.

    Only the decisions from `since` on are measured; each episode must have lasted until then.

    episode, ending: As recorded.
    ttc_min_s: Null if the ego never closed in on a leader.
    drac_max_mps2: Null if the ego never had a leader.
    imposed_braking_mps2: Null if the ego never changed lanes in front of a follower.
    abandoned_changes: Number of lane changes that were given up; see `recording.lane_changes`.
    criticality: 0 to 8; see the module.
    kind: The kind that contributes most to the criticality.
    """
    lane, wanted = (pl.col(name).shift().over("episode") for name in ("lane", "target_lane"))
    abandoned = is_given_up(lane, wanted, pl.col("lane"), pl.col("target_lane"))
    kinds = [kind for kind, _ in _MEASURES]
    measures = [measure.fill_null(0.0) for _, measure in _MEASURES]
    return (
        join_rows(episodes, steps, settings)
        .with_columns(abandoned=abandoned.fill_null(False))
        .filter(pl.col("step").fill_null(1) >= since)
        .group_by("episode", maintain_order=True)
        .agg(
            pl.first("ending"),
            ttc_min_s=pl.col("ttc_s").min(),
            drac_max_mps2=pl.col("drac_mps2").max(),
            imposed_braking_mps2=pl.col("imposed_braking_mps2").max(),
            abandoned_changes=pl.col("abandoned").sum(),
        )
        .with_columns(
            criticality=pl.sum_horizontal(measures) + COLLISION * _COLLIDED,
            kind=pl.when(_COLLIDED)
            .then(pl.lit("collision"))
            .otherwise(
                pl.concat_list(measures)
                .list.arg_max()
                .replace_strict(range(len(kinds)), kinds, return_dtype=pl.String)
            ),
        )
    )
