"""The metrics in two sets: `paper`, as the paper's tables define them, and `standard`.

`paper` counts the steps with a leader within 50 m (logged steps) and measures from centre to
centre. `standard` is what traffic safety uses: exposure in km, gaps from bumper to bumper, all
steps up to a collision.
"""

from collections.abc import Sequence

import numpy as np
import polars as pl

from charms_bench.metrics.acceleration import (
    ACC_STD,
    JERK_RMS,
    PAPER_ACC_MEAN,
    PAPER_ACC_STD,
    PAPER_HARSH_ACC_RATE,
)
from charms_bench.metrics.collisions import (
    COLLISION_RATE,
    CRASHED_EPISODES,
    CRASHES_PER_1000KM,
    OFF_ROAD_PER_1000KM,
    REAR_END_PER_1000KM,
    SIDE_PER_1000KM,
    TRAFFIC_CRASHED,
    TRAFFIC_CRASHES_PER_1000KM,
)
from charms_bench.metrics.headway import (
    DHW_MEAN,
    DHW_STD,
    SHORT_HEADWAY_S,
    TIME_HEADWAY_MEAN,
    time_headway_below,
)
from charms_bench.metrics.interaction import INTERACTION_DENSITY
from charms_bench.metrics.lane_changes import (
    IMPOSED_BRAKING_MEAN,
    LANE_CHANGES_PER_KM,
    SAFE_BRAKING_MPS2,
    imposed_braking_above,
)
from charms_bench.metrics.metric import Metric, MetricSet
from charms_bench.metrics.required_braking import DRAC_LIMIT_MPS2, DRAC_MAX, drac_above
from charms_bench.metrics.rows import join_rows
from charms_bench.metrics.speed import (
    PAPER_SPEED_MEAN,
    PAPER_SPEED_STD,
    SPEED_MEAN,
    TRAFFIC_SPEED_MEAN,
)
from charms_bench.metrics.steering import PAPER_YAW_STD
from charms_bench.metrics.time_to_collision import (
    CONFLICT_TTC_S,
    PAPER_TTC_BELOW_3S,
    PAPER_TTC_BELOW_3S_CLOSING,
    TTC_MIN,
    TTC_THRESHOLD_S,
    conflict_episodes,
    time_exposed,
    time_integrated,
    ttc_below,
)
from charms_bench.world.scene import Floats, SceneSettings

__all__ = ["METRIC_SETS", "PAPER", "STANDARD", "Metric", "MetricSet", "standard", "sums_by_episode"]

PAPER = MetricSet(
    name="paper",
    version=1,
    metrics=(
        COLLISION_RATE,
        PAPER_TTC_BELOW_3S,
        PAPER_TTC_BELOW_3S_CLOSING,
        PAPER_SPEED_MEAN,
        PAPER_SPEED_STD,
        PAPER_ACC_MEAN,
        PAPER_ACC_STD,
        PAPER_YAW_STD,
        PAPER_HARSH_ACC_RATE,
        DHW_MEAN,
        DHW_STD,
        INTERACTION_DENSITY,
    ),
)


def standard(
    ttc_s: float = TTC_THRESHOLD_S,
    conflict_ttc_s: float = CONFLICT_TTC_S,
    drac_mps2: float = DRAC_LIMIT_MPS2,
    headway_s: float = SHORT_HEADWAY_S,
    imposed_mps2: float = SAFE_BRAKING_MPS2,
) -> MetricSet:
    """The set `standard`, with other thresholds if need be.

    Args:
        ttc_s: Below which a TTC counts as exposure.
        conflict_ttc_s: Below which it is a conflict.
        drac_mps2: Above which a driver cannot be counted on to brake hard enough.
        headway_s: Below which a time headway is short.
        imposed_mps2: Above which a lane change makes the new follower brake too hard.
    """
    return MetricSet(
        name="standard",
        version=1,
        metrics=(
            CRASHED_EPISODES,
            CRASHES_PER_1000KM,
            REAR_END_PER_1000KM,
            SIDE_PER_1000KM,
            OFF_ROAD_PER_1000KM,
            conflict_episodes(conflict_ttc_s),
            TTC_MIN,
            ttc_below(ttc_s),
            time_exposed(ttc_s),
            time_integrated(ttc_s),
            DRAC_MAX,
            drac_above(drac_mps2),
            TIME_HEADWAY_MEAN,
            time_headway_below(headway_s),
            SPEED_MEAN,
            ACC_STD,
            JERK_RMS,
            LANE_CHANGES_PER_KM,
            IMPOSED_BRAKING_MEAN,
            imposed_braking_above(imposed_mps2),
            TRAFFIC_CRASHED,
            TRAFFIC_CRASHES_PER_1000KM,
            TRAFFIC_SPEED_MEAN,
        ),
    )


STANDARD = standard()
METRIC_SETS = (PAPER, STANDARD)


def sums_by_episode(
    metrics: Sequence[Metric],
    episodes: pl.DataFrame,
    steps: pl.DataFrame,
    settings: SceneSettings,
) -> list[Floats]:
    """The sums [E, k] of each metric, a row an episode, by episode.

    Args:
        metrics: Whose sums.
        episodes: E episode rows (`recording.EPISODE_SCHEMA`).
        steps: Their step rows (`recording.STEP_SCHEMA`).
        settings: What the scenes had in common.
    """
    rows = join_rows(episodes, steps, settings)
    aggregations = [
        expression.cast(pl.Float64).fill_null(0.0).alias(f"{i}.{j}")
        for i, metric in enumerate(metrics)
        for j, expression in enumerate(metric.sums)
    ]
    table = rows.group_by("episode", maintain_order=True).agg(aggregations).drop("episode")
    columns = np.cumsum([len(metric.sums) for metric in metrics])[:-1]
    return np.split(table.to_numpy(), columns, axis=1)
