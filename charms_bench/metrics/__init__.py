"""Metrics, one concept per module, and the sets in which they are reported."""

from charms_bench.metrics.metric import Metric, MetricSet
from charms_bench.metrics.paper import PAPER
from charms_bench.metrics.roads import ROADS
from charms_bench.metrics.rows import sums_by_episode
from charms_bench.metrics.sets import (
    METRIC_SETS,
    SCENARIOS,
    STANDARD,
    WARM_UP_S,
    standard,
    standard_after,
)

__all__ = [
    "METRIC_SETS",
    "PAPER",
    "ROADS",
    "SCENARIOS",
    "STANDARD",
    "WARM_UP_S",
    "Metric",
    "MetricSet",
    "standard",
    "standard_after",
    "sums_by_episode",
]
