"""A calibration, from trips to a population and to what it says of held-out drivers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from charms_bench.errors import DataError
from charms_bench.humans.calibration import SITUATION, Fit, best_lag, noise_of, of_drivers, pooled
from charms_bench.humans.car_following import MODELS
from charms_bench.humans.held_out import (
    HORIZONS_S,
    drawn,
    energy_scores,
    gap_errors,
    profile_driver,
    ratio_interval,
    scales_of,
    the_same,
)
from charms_bench.humans.population import LaneChanges, Population
from charms_bench.humans.trips import SPLIT_SEED, Driver, Trip, split
from charms_bench.world.scene import Floats

FEWEST_DRIVERS = 8
"""Fewer fitted drivers have no covariance of seven numbers."""
TIME_HEADWAYS_S = (1.0, 1.5)
"""Of the uncalibrated IDMs that a calibration is compared with."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """How well one predictor predicts the D held-out drivers."""

    name: str
    gap_errors: Floats
    """(D,) mean square of the relative error of the gap."""
    energy_scores: Floats
    """(D, H) at the horizons; NaN without a trip of 30 s."""

    @property
    def rmspe(self) -> float:
        """Root of the mean square of the relative error of the gap; drivers weigh the same."""
        return float(np.sqrt(self.gap_errors.mean()))


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fitted population and its predictions."""

    fit: Fit
    """The most likely one of all models."""
    noise: tuple[float, float]
    predicted: tuple[Predicted, ...]
    """The population, the pooled point, and the uncalibrated IDMs."""
    held_out: tuple[Trip, ...]

    @property
    def held_out_drivers(self) -> set[int]:
        """Whom nothing was fitted to."""
        return {trip.driver for trip in self.held_out}

    @property
    def gap_ratio(self) -> tuple[float, float, float]:
        """Gap error of the population over that of the better uncalibrated IDM, with interval."""
        population, _, *others = self.predicted
        best = min(others, key=lambda each: each.rmspe)
        return ratio_interval(population.gap_errors, best.gap_errors, root=True)

    @property
    def energy_ratios(self) -> list[tuple[float, float, float]]:
        """Energy score of the population over that of the pooled point, at each horizon."""
        one, other = (each.energy_scores for each in self.predicted[:2])
        return [ratio_interval(one[:, h], other[:, h], root=False) for h in range(len(HORIZONS_S))]

    def parameters(self) -> list[dict[str, str]]:
        """The parameters of the population, for a table."""
        fit = self.fit
        spread = np.exp(np.sqrt(np.diag(fit.covariance)))
        return [
            {
                "parameter": name,
                "median": f"{fit.point[k]:z.2f}",
                "spread": f"x / {spread[k]:z.2f}",
                "identified": "no" if fit.is_unidentified[k] else "yes",
            }
            for k, name in enumerate(fit.model.parameters)
        ]

    def records(self) -> list[dict[str, str]]:
        """The errors and scores on held-out drivers, for a table."""
        rows = []
        for each in self.predicted:
            row = {"predicted by": each.name, "gap error": f"{each.rmspe:z.2f}"}
            means = np.nanmean(each.energy_scores, axis=0)
            for horizon_s, score in zip(HORIZONS_S, means, strict=True):
                row[f"energy score, {horizon_s} s"] = f"{score:z.2f}"
            rows.append(row)
        return rows

    def population(
        self, name: str, origin: str, terms: str, lane_changes: LaneChanges | None
    ) -> Population:
        """The artefact that agents read."""
        fit = self.fit
        flagged = zip(fit.model.parameters, fit.is_unidentified, strict=True)
        return Population(
            name=name,
            origin=origin,
            terms=terms,
            model="idm" if fit.model.name == "idm" else "fvdm",
            parameters=(*fit.model.parameters, *SITUATION),
            mean=tuple(fit.mean.round(6).tolist()),
            covariance=tuple(tuple(row) for row in fit.covariance.round(6).tolist()),
            not_identified=tuple(parameter for parameter, is_flagged in flagged if is_flagged),
            lag_s=fit.lag_s,
            noise_mps2=round(self.noise[0], 4),
            noise_s=round(self.noise[1], 4),
            error=round(fit.error, 4),
            correlation_s=round(fit.correlation_s, 2),
            drivers=len(fit.drivers),
            drivers_at_bound=fit.at_bound,
            held_out=len(self.held_out_drivers),
            seed=SPLIT_SEED,
            lane_changes=lane_changes,
        )


def calibrate(trips: Sequence[Trip], tell: Callable[[str], None]) -> Calibration:
    """Fits the models to one half of the drivers, and predicts the other half.

    `tell` is told what comes next, which takes minutes. Raises a `DataError` if there are too few
    drivers.
    """
    fitted, held_out = split(trips)
    drivers = len(of_drivers(fitted))
    if drivers < FEWEST_DRIVERS:
        raise DataError(
            f"{drivers} drivers to fit, half of those with trips; expected {FEWEST_DRIVERS} or "
            "more, because a covariance cannot be fitted to fewer"
        )
    fits = []
    for model in MODELS.values():
        tell(f"fitting {model.name}")
        fits.append(best_lag(model, fitted))
    fit = max(fits, key=lambda each: each.log_likelihood)
    tell("noise")
    noise = noise_of(fit, fitted)
    point = pooled(fit.model, fitted, fit.lag_s)
    scales = scales_of(fitted)
    predictors: dict[str, Driver] = {
        f"{fit.model.name}, drawn from the population": drawn(fit, noise),
        f"{fit.model.name}, pooled point with noise": the_same(point, fit, noise),
        **{f"idm of the profile charms, T {t:g} s": profile_driver(t) for t in TIME_HEADWAYS_S},
    }
    predicted = []
    for name, predictor in predictors.items():
        tell(f"predicting with {name}")
        errors = gap_errors(held_out, predictor)
        predicted.append(Predicted(name, errors, energy_scores(held_out, predictor, scales)))
    return Calibration(fit, noise, tuple(predicted), tuple(held_out))
