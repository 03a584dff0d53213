"""The built-in metric sets: `paper`, as the paper's tables define it, and `standard`.

`paper` counts the steps with a leader within 50 m (logged steps) and measures from centre to
centre. `standard` follows traffic safety research: exposure in km, gaps from bumper to bumper, and
all steps between a warm-up and a collision.
"""

from charms_bench.engine.planar_ttc import HORIZON_S
from charms_bench.errors import InputError
from charms_bench.metrics import (
    acceleration,
    collisions,
    conduct,
    conflicts,
    headway,
    interaction,
    lane_changes,
    planar_conflicts,
    speed,
    steering,
)
from charms_bench.metrics import required_braking as braking
from charms_bench.metrics import time_to_collision as ttc
from charms_bench.metrics.metric import MetricSet
from charms_bench.metrics.samples import driving_after
from charms_bench.world import thresholds

WARM_UP_S = 3.0
"""The ego spawns at 30 m/s among vehicles at 23.1 to 26.4 m/s. With 600 episodes from seed
900,000,000 and an ego that spawns at 30, 27 or 24 m/s:

- After 3 s, the share of steps with more than 2.5 m/s2 is at most 0.03 % (IDM+MOBIL) and 0.15 %
  (Stackelberg) whatever the spawn; from the start of the episode, it is 3.2 and 4.0 % at 30 m/s and
  0.6 % at 24 m/s.
- The mean speed falls from 30 to 25.3 m/s (IDM+MOBIL) and 25.7 m/s (Stackelberg) in 3 s, and then
  changes by less than 0.3 m/s within another 3 s. It does not become independent of the spawn,
  because the ego's first speed is also the speed that highway-env's drivers desire.
"""

PAPER = MetricSet(
    name="paper",
    version=2,
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
        acceleration.PAPER_HARSH_ACC_RATE_ALL_STEPS,
        headway.DHW_MEAN,
        headway.DHW_STD,
        interaction.INTERACTION_DENSITY,
    ),
)


def standard(
    warm_up_s: float = WARM_UP_S,
    ttc_s: float = ttc.TTC_THRESHOLD_S,
    conflict_ttc_s: float = thresholds.CONFLICT_TTC_S,
    drac_mps2: float = thresholds.DRAC_LIMIT_MPS2,
    headway_s: float = headway.SHORT_HEADWAY_S,
    imposed_mps2: float = thresholds.HARD_BRAKING_MPS2,
) -> MetricSet:
    """The set `standard`, if need be with other thresholds.

    Args:
        warm_up_s: The first steps of an episode, up to this time, count only for collisions.
        ttc_s: A smaller TTC counts as exposure.
        conflict_ttc_s: A smaller TTC is a conflict, and a smaller planar TTC a planar conflict.
        drac_mps2: If a larger DRAC is required, a driver cannot be relied on to brake hard enough.
        headway_s: A smaller time headway is short.
        imposed_mps2: A lane change that makes the new follower brake harder is not safe.

    Raises:
        InputError: `conflict_ttc_s` exceeds the horizon of the recorded planar TTC.
    """
    if conflict_ttc_s > HORIZON_S:
        raise InputError(
            f"metric set 'standard': conflict_ttc_s is {conflict_ttc_s:g}; expected at most "
            f"{HORIZON_S:g}, because longer planar TTCs are not recorded"
        )
    driving = driving_after(warm_up_s)
    return MetricSet(
        name="standard",
        version=3,
        metrics=(
            collisions.CRASHED_EPISODES,
            collisions.CRASHED_AT_FAULT,
            collisions.CRASHES_PER_1000KM,
            collisions.REAR_END_PER_1000KM,
            collisions.STRIKING_PER_1000KM,
            collisions.STRUCK_PER_1000KM,
            collisions.REAR_END_STRIKING,
            collisions.SIDE_PER_1000KM,
            collisions.OFF_ROAD_PER_1000KM,
            conflicts.conflict_episodes(driving, conflict_ttc_s),
            conflicts.conflicts_per_1000km(driving, conflict_ttc_s),
            *conflicts.conflict_beginnings(driving, conflict_ttc_s),
            planar_conflicts.planar_conflict_episodes(driving, conflict_ttc_s),
            planar_conflicts.planar_conflicts_per_1000km(driving, conflict_ttc_s),
            planar_conflicts.planar_ttc_min(driving),
            ttc.ttc_min(driving),
            ttc.ttc_below(driving, ttc_s),
            ttc.rear_ttc_below(driving, ttc_s),
            ttc.time_exposed(driving, ttc_s),
            ttc.time_integrated(driving, ttc_s),
            braking.drac_max(driving),
            braking.drac_above(driving, drac_mps2),
            headway.time_headway_mean(driving),
            headway.time_headway_below(driving, headway_s),
            speed.speed_mean(driving),
            acceleration.acc_std(driving),
            acceleration.harsh_acc_rate(driving),
            acceleration.jerk_rms(driving),
            steering.yaw_rate_rms(driving),
            lane_changes.lane_changes_per_km(driving),
            lane_changes.lane_change_duration_mean(driving),
            lane_changes.lead_gap_mean(driving),
            lane_changes.lag_gap_mean(driving),
            lane_changes.imposed_braking_mean(driving),
            lane_changes.imposed_braking_above(driving, imposed_mps2),
            collisions.TRAFFIC_CRASHED,
            collisions.TRAFFIC_CRASHES_PER_1000KM,
            speed.TRAFFIC_SPEED_MEAN,
            *conduct.EGO_CONDUCT,
            *conduct.TRAFFIC_CONDUCT,
        ),
    )


STANDARD = standard()
METRIC_SETS = (PAPER, STANDARD)
