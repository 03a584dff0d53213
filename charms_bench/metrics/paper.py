"""The metric set `paper`, as the paper's tables define it.

It counts the steps with a leader within 50 m (logged steps), and measures distance headways (DHW)
and times to collision from centre to centre.
"""

import polars as pl

from charms_bench.metrics.collisions import ENDED_BADLY
from charms_bench.metrics.metric import Metric, MetricSet
from charms_bench.metrics.row_samples import LOGGED, STEPS
from charms_bench.metrics.speed_and_smoothness import ACCELERATION, HARSH, SPEED
from charms_bench.metrics.time_to_collision import TTC_CAP_S, TTC_THRESHOLD_S

_DISTANCE = pl.col("leader_distance")
_CLOSING = LOGGED.among("closing steps", pl.col("leader_speed") < SPEED)
_TTC = (
    pl.when(_CLOSING.where)
    .then(_DISTANCE / (SPEED - pl.col("leader_speed")))
    .otherwise(TTC_CAP_S)
    .clip(upper_bound=TTC_CAP_S)
)
_HEADWAY = "distance headway with a leader within 50 m"

PAPER = MetricSet(
    name="paper",
    version=2,
    metrics=(
        Metric(
            name="collision_rate",
            unit="1/step",
            description="episodes that end with a collision or off the road, per decision",
            rests_on="steps",
            sums=(pl.first("steps"), pl.first("steps"), ENDED_BADLY),
            interval="garwood",
        ),
        LOGGED.proportion(
            "ttc_below_3s",
            _TTC < TTC_THRESHOLD_S,
            "proportion with a centre-to-centre TTC below 3 s among the decisions with a leader "
            "within 50 m",
        ),
        _CLOSING.proportion(
            "ttc_below_3s_closing",
            _TTC < TTC_THRESHOLD_S,
            "proportion with a centre-to-centre TTC below 3 s among the decisions with a leader "
            "within 50 m in which the ego is faster than its leader",
        ),
        LOGGED.mean("speed_mean", "m/s", SPEED, "speed with a leader within 50 m"),
        LOGGED.deviation("speed_std", "m/s", SPEED, "speed with a leader within 50 m"),
        LOGGED.among("accelerating steps", ACCELERATION > 0).mean(
            "acc_mean",
            "m/s²",
            ACCELERATION,
            "mean of the positive accelerations with a leader within 50 m",
        ),
        LOGGED.deviation("acc_std", "m/s²", ACCELERATION, "acceleration with a leader within 50 m"),
        LOGGED.deviation(
            "yaw_std", "rad", pl.col("steering"), "steering angle with a leader within 50 m"
        ),
        LOGGED.proportion(
            "harsh_acc_rate",
            HARSH,
            "proportion of the decisions with a leader within 50 m in which the ego accelerates or "
            "brakes by more than 2.5 m/s²",
        ),
        STEPS.proportion(
            "harsh_acc_rate_all_steps",
            HARSH,
            "proportion of all steps in which the ego accelerates or brakes by more than 2.5 m/s²",
        ),
        LOGGED.mean("dhw_mean", "m", _DISTANCE, _HEADWAY),
        LOGGED.deviation("dhw_std", "m", _DISTANCE, _HEADWAY),
        LOGGED.mean(
            "interaction_density",
            "vehicles",
            pl.col("vehicles_near"),
            "vehicles within 30 m and at most one lane away, the ego included, if a leader is "
            "within 50 m",
        ),
    ),
)
