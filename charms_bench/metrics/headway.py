"""How far behind its leader the ego drives, and how fast it closes in as the headway gets short.

Time headways are from front to front.

With a headway above 6 s, a driver drives freely (Vogel 2003, Accident Analysis and Prevention 35).
"""

import polars as pl

from charms_bench.metrics.metric import Metric, in_name
from charms_bench.metrics.row_samples import Sample
from charms_bench.metrics.rows import IS_LATER
from charms_bench.world.gaps import is_within

FREE_HEADWAY_S = 6.0
SHORT_HEADWAY_S = 1.0
NEAR_M = 100.0
"""Distance between centres up to which a leader counts as near."""
DISTANCE = pl.col("leader_distance")
HEADWAY = pl.col("time_headway_s")


def of_headway(driving: Sample, threshold_s: float) -> tuple[Metric, ...]:
    """The mean while the ego follows a leader, the time below a threshold, and how it gets there.

    Studies of recorded drivers often measure from centre to centre, near a leader only.
    """
    # An episode's rows are aggregated by themselves, so this sees no other episode.
    was_longer = HEADWAY.shift().ge(threshold_s) & ~pl.col("leader_changed")
    had_no_leader = IS_LATER & DISTANCE.shift().is_null()
    falls = HEADWAY.lt(threshold_s) & (was_longer | had_no_leader)
    closing = (pl.col("speed") - pl.col("leader_speed")).clip(0.0)
    near = driving.among("steps with a leader within 100 m", DISTANCE <= NEAR_M)
    return (
        driving.among("following steps", HEADWAY <= FREE_HEADWAY_S).mean(
            "time_headway_mean", "s", HEADWAY, "time headway while it is at most 6 s"
        ),
        driving.proportion(
            f"time_headway_below_{in_name(threshold_s)}s",
            HEADWAY.lt(threshold_s),
            f"proportion of time with a time headway below {threshold_s:g} s",
        ),
        near.proportion(
            f"centre_headway_below_{in_name(threshold_s)}s",
            is_within(DISTANCE, pl.col("speed"), threshold_s),
            "proportion of the time with a leader within 100 m in which the distance between "
            f"centres, divided by the ego's speed, is below {threshold_s:g} s",
        ),
        driving.among(
            f"decisions at which the time headway falls below {threshold_s:g} s", falls
        ).mean(
            f"closing_speed_below_{in_name(threshold_s)}s_mean",
            "m/s",
            closing,
            "speed at which the ego closes in on its leader when the time headway falls below "
            f"{threshold_s:g} s, 0 if the leader is faster",
        ),
    )
