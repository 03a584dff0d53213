"""A metric of two sums, for tests that compute with the sums alone."""

import polars as pl

from charms_bench.metrics.metric import Interval, Metric, ratio


def metric_of(interval: Interval = "bootstrap", value=ratio) -> Metric:
    return Metric("made_up", "", "", "steps", (pl.lit(1), pl.lit(1)), value, interval)
