"""How many vehicles the ego has to do with."""

import polars as pl

from charms_bench.metrics.metric import Metric, ratio, total

INTERACTION_DENSITY = Metric(
    name="interaction_density",
    unit="vehicles",
    description="vehicles within 30 m and at most one lane away in logged steps, the ego included",
    rests_on="logged steps",
    sums=(pl.col("logged").sum(), total(pl.col("vehicles_near"), pl.col("logged"))),
    value=ratio,
)
