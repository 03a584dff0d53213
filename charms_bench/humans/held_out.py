"""How well a calibrated population predicts drivers that it was not fitted to."""

from collections.abc import Sequence

import numpy as np

from charms_bench.humans.calibration import Fit, of_drivers, ou_noise, situation_of
from charms_bench.humans.car_following import IDM, drive
from charms_bench.humans.trips import RATE_HZ, Driver, Trip
from charms_bench.statistics.energy_score import energy_score
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import Floats

HORIZONS_S = (10, 20, 30)
STARTS_EVERY_S = 10
DRAWS = 64
RESAMPLES = 2000
_GAPS_M = (0.5, 300.0)
SEED = 29
"""Of draws and of resamples of drivers."""


def profile_idm(time_headway_s: float) -> Floats:
    """(P,) the parameters of IDM in the profile `charms`, with another time headway."""
    p, length = CHARMS.idm_mobil, CHARMS.vehicle_length_m
    jam_m = p.jam_distance_m - length  # the profile's is from centre to centre
    both = p.acceleration_mps2, p.deceleration_mps2
    return np.array([CHARMS.speed_limit_mps, time_headway_s, jam_m, *both])


def drawn(fit: Fit, noise: tuple[float, float]) -> Driver:
    """Drivers drawn from the population in the trip's situation."""

    def predict(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        p = fit.draw(rng, DRAWS, situation_of([trip]))
        pushes = ou_noise(rng, (DRAWS, trip.gap.size), *noise)
        return drive(fit.model, trip, p, fit.lag_s, pushes)

    return predict


def the_same(p: Floats, fit: Fit, noise: tuple[float, float]) -> Driver:
    """One set of parameters (P,) for all drivers, with noise."""

    def predict(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        pushes = ou_noise(rng, (DRAWS, trip.gap.size), *noise)
        return drive(fit.model, trip, np.tile(p, (DRAWS, 1)), fit.lag_s, pushes)

    return predict


def profile_driver(time_headway_s: float) -> Driver:
    """IDM with the constants of the profile `charms`, without lag or noise."""
    return lambda trip, _: drive(IDM, trip, profile_idm(time_headway_s)[None])


def gap_errors(trips: Sequence[Trip], predictor: Driver) -> Floats:
    """(D,) mean square of the relative error of the gap, by driver.

    Of several draws, the prediction is the gap with the smallest expected square relative error,
    E(1 / gap) / E(1 / gap^2) (Gneiting 2011, section 2.3).
    """
    found = []
    for driver, own in of_drivers(trips).items():
        rng, squares = np.random.default_rng([SEED, driver]), []
        for trip in own:
            gaps = np.clip(predictor(trip, rng)[0], *_GAPS_M)
            predicted = (1 / gaps).mean(axis=0) / (1 / gaps**2).mean(axis=0)
            squares.append((predicted / trip.gap - 1) ** 2)
        found.append(np.concatenate(squares).mean())
    return np.array(found)


def energy_scores(trips: Sequence[Trip], predictor: Driver, scales: Floats) -> Floats:
    """(D, H) energy scores of gap and speed at the horizons, by driver; NaN without a start.

    Predictions start every 10 s. `scales` (H, 2) divide gaps and speeds.
    """
    found = []
    for driver, own in of_drivers(trips).items():
        rng, scores = np.random.default_rng([SEED, driver]), []
        for part in starts(own):
            gaps, speeds = predictor(part, rng)
            at = np.array(HORIZONS_S) * RATE_HZ
            draws = np.stack([gaps[:, at], speeds[:, at]], axis=-1) / scales
            observed = np.stack([part.gap[at], part.speed[at]], axis=-1) / scales
            scores.append(energy_score(draws.swapaxes(0, 1), observed))
        found.append(np.mean(scores, axis=0) if scores else np.full(len(HORIZONS_S), np.nan))
    return np.array(found)


def starts(trips: Sequence[Trip]) -> list[Trip]:
    """The stretches of 30 s of these trips that start every 10 s."""
    length = max(HORIZONS_S) * RATE_HZ + 1
    found = []
    for trip in trips:
        for first in range(0, trip.gap.size - length + 1, STARTS_EVERY_S * RATE_HZ):
            part = slice(first, first + length)
            leader_x = trip.leader_x[part] - trip.leader_x[first] + trip.gap[first]
            arrays = trip.gap[part], trip.speed[part], leader_x, trip.leader_speed[part]
            found.append(Trip(trip.driver, *arrays))
    return found


def scales_of(trips: Sequence[Trip]) -> Floats:
    """(H, 2) standard deviations of the changes of gap and speed over the horizons."""
    parts = starts(trips)
    at = np.array(HORIZONS_S) * RATE_HZ
    gaps = np.array([part.gap[at] - part.gap[0] for part in parts])
    speeds = np.array([part.speed[at] - part.speed[0] for part in parts])
    return np.stack([gaps.std(axis=0), speeds.std(axis=0)], axis=-1)


def ratio_interval(one: Floats, other: Floats, root: bool) -> tuple[float, float, float]:
    """The ratio of two means over drivers (D,), or of their roots, with a 95 % interval."""
    defined = np.isfinite(one) & np.isfinite(other)
    one, other = one[defined], other[defined]
    rng = np.random.default_rng(SEED)
    chosen = rng.integers(one.size, size=(RESAMPLES, one.size))
    ratios = one[chosen].mean(axis=1) / other[chosen].mean(axis=1)
    value = one.mean() / other.mean()
    low, high = np.quantile(ratios, [0.025, 0.975])
    if root:
        value, low, high = np.sqrt([value, low, high])
    return float(value), float(low), float(high)
