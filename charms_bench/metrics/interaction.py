"""How many vehicles are near the ego."""

import polars as pl

from charms_bench.metrics.metric import Metric, total
from charms_bench.metrics.rows import LOGGED

INTERACTION_DENSITY = Metric(
    name="interaction_density",
    unit="vehicles",
    description="vehicles within 30 m and at most one lane away in logged steps, the ego included",
    rests_on="logged steps",
    sums=(LOGGED.sum(), total(pl.col("vehicles_near"), LOGGED)),
)
