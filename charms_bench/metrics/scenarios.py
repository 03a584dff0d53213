"""What a suite of scenarios adds: how many concrete scenarios no other metric counts."""

import polars as pl

from charms_bench.metrics.metric import EPISODES, Metric, MetricSet

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
