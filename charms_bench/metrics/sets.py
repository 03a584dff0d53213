"""The built-in metric sets: `paper`, as the paper's tables define it, and `standard`.

`paper` counts the steps with a leader within 50 m (logged steps) and measures from centre to
centre. `standard` is what traffic safety uses: exposure in km, gaps from bumper to bumper, all
steps up to a collision.
"""

from charms_bench.metrics import (
    acceleration,
    collisions,
    conduct,
    headway,
    interaction,
    lane_changes,
    speed,
    steering,
)
from charms_bench.metrics import required_braking as braking
from charms_bench.metrics import time_to_collision as ttc
from charms_bench.metrics.metric import MetricSet

PAPER = MetricSet(
    name="paper",
    version=1,
    metrics=(
        collisions.COLLISION_RATE,
        ttc.PAPER_TTC_BELOW_3S,
        ttc.PAPER_TTC_BELOW_3S_CLOSING,
        speed.PAPER_SPEED_MEAN,
        speed.PAPER_SPEED_STD,
        acceleration.PAPER_ACC_MEAN,
        acceleration.PAPER_ACC_STD,
        steering.PAPER_YAW_STD,
        acceleration.PAPER_HARSH_ACC_RATE,
        headway.DHW_MEAN,
        headway.DHW_STD,
        interaction.INTERACTION_DENSITY,
    ),
)


def standard(
    ttc_s: float = ttc.TTC_THRESHOLD_S,
    conflict_ttc_s: float = ttc.CONFLICT_TTC_S,
    drac_mps2: float = braking.DRAC_LIMIT_MPS2,
    headway_s: float = headway.SHORT_HEADWAY_S,
    imposed_mps2: float = lane_changes.SAFE_BRAKING_MPS2,
) -> MetricSet:
    """The set `standard`, if need be with other thresholds.

    Args:
        ttc_s: A smaller TTC counts as exposure.
        conflict_ttc_s: A smaller TTC is a conflict.
        drac_mps2: If a larger DRAC is required, a driver cannot be relied on to brake hard enough.
        headway_s: A smaller time headway is short.
        imposed_mps2: A lane change that makes the new follower brake harder is not safe.
    """
    return MetricSet(
        name="standard",
        version=1,
        metrics=(
            collisions.CRASHED_EPISODES,
            collisions.CRASHES_PER_1000KM,
            collisions.REAR_END_PER_1000KM,
            collisions.SIDE_PER_1000KM,
            collisions.OFF_ROAD_PER_1000KM,
            ttc.conflict_episodes(conflict_ttc_s),
            ttc.TTC_MIN,
            ttc.ttc_below(ttc_s),
            ttc.time_exposed(ttc_s),
            ttc.time_integrated(ttc_s),
            braking.DRAC_MAX,
            braking.drac_above(drac_mps2),
            headway.TIME_HEADWAY_MEAN,
            headway.time_headway_below(headway_s),
            speed.SPEED_MEAN,
            acceleration.ACC_STD,
            acceleration.JERK_RMS,
            lane_changes.LANE_CHANGES_PER_KM,
            lane_changes.IMPOSED_BRAKING_MEAN,
            lane_changes.imposed_braking_above(imposed_mps2),
            collisions.TRAFFIC_CRASHED,
            collisions.TRAFFIC_CRASHES_PER_1000KM,
            speed.TRAFFIC_SPEED_MEAN,
            *conduct.EGO_CONDUCT,
            *conduct.TRAFFIC_CONDUCT,
        ),
    )


STANDARD = standard()
METRIC_SETS = (PAPER, STANDARD)
