"""What one of highway-env's roads adds: whether the ego reaches its goal there, and when."""

import polars as pl

from charms_bench.metrics.collisions import ENDING
from charms_bench.metrics.metric import MetricSet, per_episode

REACHED = ENDING == "goal"

ROADS = MetricSet(
    name="roads",
    version=1,
    metrics=(
        per_episode(
            "goal_reached",
            "",
            REACHED,
            "proportion of episodes in which the ego reaches the goal of its road",
            interval="wilson",
        ),
        per_episode(
            "time_to_goal",
            "s",
            pl.when(REACHED).then(pl.first("duration_s")),
            "time in which the ego reaches the goal of its road",
            rests_on="episodes with the goal reached",
            counts=REACHED,
        ),
    ),
)
