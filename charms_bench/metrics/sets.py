"""The built-in metric sets: `paper`, as the paper's tables define it, and `standard`.

`paper` counts the steps with a leader within 50 m (logged steps) and measures from centre to
centre. `standard` follows traffic safety research: exposure in km, gaps from bumper to bumper, and
all steps between a warm-up and a collision.
"""

from dataclasses import replace

import polars as pl

from charms_bench.errors import InputError
from charms_bench.metrics import collisions, conduct
from charms_bench.metrics.conflicts import of_conflicts, of_planar_conflicts
from charms_bench.metrics.headway import SHORT_HEADWAY_S, of_headway
from charms_bench.metrics.lane_changes import of_lane_changes
from charms_bench.metrics.mean_acceleration import STRONG_MPS2, of_mean_acceleration
from charms_bench.metrics.metric import EPISODES, Metric, MetricSet
from charms_bench.metrics.paper import PAPER
from charms_bench.metrics.required_braking import of_required_braking
from charms_bench.metrics.row_samples import driving_after
from charms_bench.metrics.speed_and_smoothness import TRAFFIC_SPEED_MEAN, of_motion
from charms_bench.metrics.time_to_collision import TTC_THRESHOLD_S, of_time_to_collision
from charms_bench.recording.planar_ttc import HORIZON_S
from charms_bench.world import thresholds

WARM_UP_S = 3.0
"""Where vehicles are drawn on the motorway. The ego spawns at 30 m/s among vehicles at 23.1 to
26.4 m/s. With 600 episodes from seed 900,000,000 and an ego that spawns at 30, 27 or 24 m/s:

- After 3 s, the proportion of steps with more than 2.5 m/s2 is at most 0.03 % (IDM+MOBIL) and
  0.15 % (Stackelberg) whatever the spawn; from the start of the episode, it is 3.2 and 4.0 % at
  30 m/s and 0.6 % at 24 m/s.
- The mean speed falls from 30 to 25.3 m/s (IDM+MOBIL) and 25.7 m/s (Stackelberg) in 3 s, and then
  changes by less than 0.3 m/s within another 3 s. It does not become independent of the spawn,
  because the ego's first speed is also the speed that highway-env's drivers desire.
"""


def standard(
    warm_up_s: float = WARM_UP_S,
    ttc_s: float = TTC_THRESHOLD_S,
    conflict_ttc_s: float = thresholds.CONFLICT_TTC_S,
    drac_mps2: float = thresholds.DRAC_LIMIT_MPS2,
    headway_s: float = SHORT_HEADWAY_S,
    imposed_mps2: float = thresholds.HARD_BRAKING_MPS2,
    strong_mps2: float = STRONG_MPS2,
) -> MetricSet:
    """The set `standard`, if need be with other thresholds.

    Args:
        warm_up_s: The first steps of an episode, up to this time, count only for collisions.
        ttc_s: A smaller TTC counts as exposure.
        conflict_ttc_s: A smaller TTC is a conflict, and a smaller planar TTC a planar conflict.
        drac_mps2: If a larger DRAC is required, a driver cannot be relied on to brake hard enough.
        headway_s: A smaller headway is short, from front to front and between centres.
        imposed_mps2: A lane change that makes the new follower brake harder is not safe.
        strong_mps2: A larger mean acceleration over a decision interval is strong.

    Raises:
        InputError: `conflict_ttc_s` exceeds the horizon of the recorded planar TTC.
    """
    if conflict_ttc_s > HORIZON_S:
        raise InputError(
            f"metric set 'standard': conflict_ttc_s is {conflict_ttc_s:g}; expected at most "
            f"{HORIZON_S:g}, because longer planar TTCs are not recorded"
        )
    driving = driving_after(warm_up_s)
    of_driving = (
        *of_conflicts(driving, conflict_ttc_s),
        *of_planar_conflicts(driving, conflict_ttc_s),
        *of_time_to_collision(driving, ttc_s),
        *of_required_braking(driving, drac_mps2),
        *of_headway(driving, headway_s),
        *of_motion(driving),
        *of_mean_acceleration(driving, strong_mps2),
        *of_lane_changes(driving, imposed_mps2),
    )
    left_out = f"; without the first {warm_up_s:g} s of an episode" if warm_up_s else ""
    return MetricSet(
        name="standard",
        version=5,
        metrics=(
            *collisions.OF_EGO,
            *(replace(each, description=each.description + left_out) for each in of_driving),
            *collisions.OF_TRAFFIC,
            TRAFFIC_SPEED_MEAN,
            *conduct.EGO_CONDUCT,
            *conduct.TRAFFIC_CONDUCT,
        ),
    )


STANDARD = standard()
METRIC_SETS = (PAPER, STANDARD)
"""Those of every suite; suites on highway-env's roads have `roads.ROADS`, too, and suites of
scenarios `SCENARIOS`."""
_LEFT_OUT = pl.first("left_out")
SCENARIOS = MetricSet(
    name="scenarios",
    version=1,
    metrics=(
        Metric(
            name="scenarios_left_out",
            unit="",
            description="proportion of concrete scenarios that nothing else counts, because "
            "prescribed vehicles collide with one another in them whatever the ego does",
            rests_on="concrete scenarios",
            sums=(EPISODES + _LEFT_OUT, _LEFT_OUT),
        ),
    ),
)
"""What a suite of scenarios adds: how many concrete scenarios no other metric counts."""


def standard_after(warm_up_s: float) -> MetricSet:
    """The set `standard` after another warm-up, which is part of its label."""
    if warm_up_s == WARM_UP_S:
        return STANDARD
    return replace(standard(warm_up_s), options=f"warm_up_s={warm_up_s:g}")
