"""How many vehicles are near the ego."""

import polars as pl

from charms_bench.metrics.samples import LOGGED

INTERACTION_DENSITY = LOGGED.mean(
    "interaction_density",
    "vehicles",
    pl.col("vehicles_near"),
    "vehicles within 30 m and at most one lane away, the ego included, if a leader is within 50 m",
)
