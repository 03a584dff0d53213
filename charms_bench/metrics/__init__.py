"""Metrics, one concept per module, and the sets in which they are reported."""

from charms_bench.metrics.metric import Metric as Metric
from charms_bench.metrics.metric import MetricSet as MetricSet
from charms_bench.metrics.paper import PAPER as PAPER
from charms_bench.metrics.roads import ROADS as ROADS
from charms_bench.metrics.rows import sums_by_episode as sums_by_episode
from charms_bench.metrics.sets import METRIC_SETS as METRIC_SETS
from charms_bench.metrics.sets import SCENARIOS as SCENARIOS
from charms_bench.metrics.sets import STANDARD as STANDARD
from charms_bench.metrics.sets import WARM_UP_S as WARM_UP_S
from charms_bench.metrics.sets import standard as standard
from charms_bench.metrics.sets import standard_after as standard_after
