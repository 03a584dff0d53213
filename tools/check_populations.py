"""How populations predict held-out drivers: `python tools/check_populations.py DATA [FOLDER]`.

The populations are those in the package, or those that make_populations.py wrote into FOLDER. Their
drivers are drawn given what is known at the start of a trip, and compared as `charms-bench
calibrate` does; then the same for drivers who also suit the start, as those of the agent `human`.
"""

import sys
from pathlib import Path

import numpy as np
from make_populations import FILES

from charms_bench.people.calibration import conditional, ou_noise, situation_of
from charms_bench.people.car_following import MODELS, drive
from charms_bench.people.controls import calibrated
from charms_bench.people.held_out import (
    DRAWS,
    HORIZONS_S,
    Predictor,
    energy_scores,
    gap_errors,
    profile_driver,
    ratio_interval,
    scales_of,
)
from charms_bench.people.population import Population, read_population
from charms_bench.people.trips import Trip, read_trips, split
from charms_bench.world.scene import Floats


def drawn(population: Population) -> Predictor:
    """Drivers of a population, given what is known at the start of a trip."""

    def predict(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        mean, covariance = conditional(*population.arrays, situation_of([trip]))
        p = np.exp(rng.multivariate_normal(mean, covariance, size=DRAWS))
        noise = ou_noise(rng, (DRAWS, trip.gap.size), population.noise_mps2, population.noise_s)
        return drive(MODELS[population.model], trip, p, population.lag_s, noise)

    return predict


def main(data: Path, folder: Path | None) -> None:
    """Prints errors and their ratios to those of the uncalibrated IDM."""
    for name, file in FILES.items():
        population = read_population(str(folder / f"{name}.json") if folder else name)
        fitted, held_out = split(read_trips(data / file))
        scales = scales_of(fitted)
        plain = [gap_errors(held_out, profile_driver(each)) for each in (1.0, 1.5)]
        better = min(plain, key=lambda each: float(each.mean()))
        predictors = {
            "drawn": drawn(population),
            "drawn, suited to the start": calibrated(population, repetitions=DRAWS),
        }
        scores = {}
        for label, predictor in predictors.items():
            errors = gap_errors(held_out, predictor)
            scores[label] = energy_scores(held_out, predictor, scales)
            ratio = "{:.2f} [{:.2f}, {:.2f}]".format(*ratio_interval(errors, better, root=True))
            middle = np.sqrt(np.median(errors))
            print(f"{name}, {label}: gap error {np.sqrt(errors.mean()):.2f}, of the better "
                  f"uncalibrated IDM {ratio}; of the median driver {middle:.2f}")  # fmt: skip
        one, other = (np.nanmean(each, axis=0) for each in reversed(scores.values()))
        for horizon_s, ratio in zip(HORIZONS_S, one / other, strict=True):
            print(f"  energy score after {horizon_s} s, suited over drawn: {ratio:.2f}")


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit("usage: python tools/check_populations.py DATA [FOLDER]")
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) == 3 else None)
