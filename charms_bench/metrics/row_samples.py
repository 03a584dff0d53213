"""The rows over which a metric is taken, such as all decisions before a collision."""

from typing import NamedTuple

import polars as pl

from charms_bench.metrics.metric import Metric, root_mean_square, standard_deviation, total

PERIOD_S = 5.0
"""For intervals of rates that were never observed, an event happens at most once in this time."""


class Sample(NamedTuple):
    """Some of the rows, and the metrics that can be taken over them."""

    name: str
    """`Metric.rests_on`."""
    where: pl.Expr

    def among(self, name: str, condition: pl.Expr) -> "Sample":
        """The rows of this sample in which a condition holds."""
        return Sample(name, self.where & condition)

    def only(self, value: pl.Expr) -> pl.Expr:
        """A value in the rows of this sample; null in all other rows."""
        return pl.when(self.where).then(value)

    def mean(self, name: str, unit: str, value: pl.Expr, description: str) -> Metric:
        """The mean of a value."""
        sums = (self.where.sum(), total(value, self.where))
        return Metric(name, unit, description, self.name, sums)

    def deviation(self, name: str, unit: str, value: pl.Expr, what: str) -> Metric:
        """The standard deviation of a value."""
        sums = (self.where.sum(), total(value, self.where), total(value.pow(2), self.where))
        description = f"standard deviation of the {what}"
        return Metric(name, unit, description, self.name, sums, standard_deviation)

    def root_mean_square(self, name: str, unit: str, value: pl.Expr, what: str) -> Metric:
        """The root mean square of a value."""
        sums = (self.where.sum(), total(value.pow(2), self.where))
        description = f"root mean square of the {what}"
        return Metric(name, unit, description, self.name, sums, root_mean_square)

    def proportion(self, name: str, happens: pl.Expr, description: str) -> Metric:
        """The proportion of the rows in which a condition holds."""
        sums = (self.where.sum(), (self.where & happens).sum())
        return Metric(name, "", description, self.name, sums, interval="proportion")

    def per_km(self, name: str, happens: pl.Expr, what: str, km: int = 1) -> Metric:
        """The rows in which a condition holds, per `km` kilometres driven in this sample."""
        distance = "km" if km == 1 else f"{km:,} km"
        description = f"{what}, per {distance} driven"
        driven = total(pl.col("driven_m"), self.where) / (1000 * km)
        return self._rate(name, f"1/{distance}", happens, description, driven)

    def per_minute(self, name: str, happens: pl.Expr, what: str) -> Metric:
        """The rows in which a condition holds, per minute of this sample."""
        minutes = total(pl.col("interval_s"), self.where) / 60
        return self._rate(name, "1/min", happens, f"{what}, per minute", minutes)

    def _rate(
        self, name: str, unit: str, happens: pl.Expr, description: str, exposure: pl.Expr
    ) -> Metric:
        return Metric(
            name=name,
            unit=unit,
            description=description,
            rests_on=f"periods of {PERIOD_S:g} s",
            sums=(
                total(pl.col("interval_s"), self.where) / PERIOD_S,
                exposure,
                (self.where & happens).sum(),
            ),
            interval="rate",
        )


STEPS = Sample("steps", pl.col("step").is_not_null())
LOGGED = Sample("decisions near a leader", pl.col("logged"))


def driving_after(warm_up_s: float) -> Sample:
    """The steps of the set `standard`: all after a warm-up, without the step of a collision."""
    name = f"steps after {warm_up_s:g} s" if warm_up_s else "steps"
    return Sample(name, pl.col("driving") & (pl.col("time_s") > warm_up_s))
