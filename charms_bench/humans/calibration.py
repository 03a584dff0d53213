"""Fits populations of drivers to trips: nonlinear mixed effects, in closed loop.

The logarithms of a driver's parameters and of the situation, `SITUATION`, are jointly normal, with
a mean and a covariance that are fitted (Lindstrom & Bates 1990, with Laplace's approximation of the
drivers' posteriors). So a driver's desired speed, for example, depends on the speed at the start.
A driver's likelihood rests on the logarithm of simulated over recorded gap. These errors stay alike
for seconds, so a trip counts as many independent errors as it has correlation times.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from charms_bench.humans.car_following import LEAST_GAP_M, MODELS, Model, drive
from charms_bench.humans.population import Population
from charms_bench.humans.trips import RATE_HZ, Trip
from charms_bench.world.scene import Bools, Floats

ITERATIONS = 15
"""Of expectation and maximisation."""
PRIOR_SD = 1.0
"""Of the prior of the mean, around the published parameters, in logarithms."""
SPREAD_SD, SPREAD_DRIVERS = 0.3, 5.0
"""The prior of the covariance: as many drivers with this standard deviation, in logarithms."""
BOUND = 3.0
"""A driver fitted alone stays within exp(±3) of the published parameters."""
UNIDENTIFIED = 0.5
"""A parameter whose posterior variance of single drivers is more than this proportion of the
population's variance is flagged: most of what is said of a driver comes from the other drivers."""
SLOWEST_MPS = 3.0
"""Slower speeds count as this one in a situation, because time gaps of stopping drivers say
little."""
SITUATION = ("first_time_gap_s", "first_speed_mps")
"""What a driver's parameters are correlated with; see `situation_of`."""
LAGS_S = (0.0, 0.3, 0.6, 1.0)
"""The lags that are tried; the one with the largest log-likelihood is taken."""
NOISE_START = (0.2, 1.5)
NOISE_BOUNDS = ((0.01, 2.0), (0.2, 20.0))
"""Standard deviation in m/s2 and correlation time in s of noise; the start of the search is near
what was found for highD (Zhang & Sun 2024)."""
_REPETITIONS = 4
_EVERY = RATE_HZ // 2
_GAPS_M = (LEAST_GAP_M, 300.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """A population of drivers, fitted to trips; P parameters, D drivers."""

    model: Model
    lag_s: float
    mean: Floats
    """(P + 2,) of the logarithms of the parameters and of the situation, `SITUATION`."""
    covariance: Floats
    """(P + 2, P + 2) likewise."""
    error: float
    """Standard deviation of the logarithm of simulated over recorded gap within drivers."""
    correlation_s: float
    """Time over which these errors stay alike."""
    log_likelihood: float
    """Laplace's approximation of the marginal log-likelihood of all errors."""
    drivers: tuple[int, ...]
    modes: Floats
    """(D, P) the most probable logarithms of each driver's parameters."""
    uncertainty: Floats
    """(P,) mean posterior variance of a driver's parameters, of the population's variance."""
    at_bound: int
    """Drivers whose fit ends at a bound if they are fitted alone."""

    @property
    def point(self) -> Floats:
        """(P,) the parameters of the median driver."""
        return np.exp(self.mean[:-2])

    @property
    def is_unidentified(self) -> Bools:
        """(P,) whether the trips say little about the parameter of a single driver."""
        return self.uncertainty > UNIDENTIFIED

    def draw(self, rng: np.random.Generator, count: int, situation: Floats) -> Floats:
        """(count, P) parameters of drivers of this population in this situation (2,)."""
        mean, covariance = conditional(self.mean, self.covariance, situation)
        return np.exp(rng.multivariate_normal(mean, covariance, size=count))


def fit_population(model: Model, trips: Sequence[Trip], lag_s: float) -> Fit:
    """The population of the trips' drivers."""
    usual = np.log(model.usual)
    by_driver = of_drivers(trips)
    own = [_Driver(model, each, lag_s) for each in by_driver.values()]
    alone = np.array([driver.fit_alone(usual) for driver in own])
    at_bound = int((np.abs(alone - usual) > BOUND - 0.01).any(axis=1).sum())
    # With the errors of the hierarchical fit, weak data would be given ever less weight.
    error, correlation_s = _spread([d.errors(each) for d, each in zip(own, alone, strict=True)])
    modes = np.clip(alone, usual - PRIOR_SD, usual + PRIOR_SD)
    situations = np.array([situation_of(each) for each in by_driver.values()])
    size, count = usual.size, len(own)
    mean = np.concatenate([usual, situations.mean(axis=0)])
    prior = covariance = np.eye(mean.size) * SPREAD_SD**2
    prior_precision = np.diag(np.repeat([PRIOR_SD**-2, 0.0], [size, situations.shape[1]]))
    posterior, evidence = np.zeros((count, mean.size, mean.size)), np.zeros(count)
    for _ in range(ITERATIONS):
        for d, driver in enumerate(own):
            expected, spread = conditional(mean, covariance, situations[d])
            found = driver.fit(modes[d], expected, spread, error, correlation_s)
            modes[d], posterior[d, :size, :size], evidence[d] = found
        joint = np.concatenate([modes, situations], axis=1)
        precision = np.linalg.inv(covariance) * count
        around = np.concatenate([usual, mean[size:]])
        weighted = precision @ joint.mean(axis=0) + prior_precision @ around
        mean = np.linalg.solve(precision + prior_precision, weighted)
        apart = joint - mean
        scatter = apart.T @ apart + posterior.sum(axis=0) + prior * SPREAD_DRIVERS
        covariance = scatter / (count + SPREAD_DRIVERS)
    variances = np.diagonal(posterior, axis1=1, axis2=2).mean(axis=0) / np.diag(covariance)
    fitted = model, lag_s, mean, covariance, error, correlation_s, float(evidence.sum())
    return Fit(*fitted, tuple(by_driver), modes, variances[:size], at_bound)


def of_drivers(trips: Sequence[Trip]) -> dict[int, list[Trip]]:
    """The trips of each driver."""
    found: dict[int, list[Trip]] = {}
    for trip in trips:
        found.setdefault(trip.driver, []).append(trip)
    return found


def situation_of(trips: Sequence[Trip]) -> Floats:
    """(2,) logarithms of the first time gap in s and the first speed in m/s.

    A driver knows both when the trip starts. They are means over a driver's trips.
    """
    speeds = np.array([max(trip.speed[0], SLOWEST_MPS) for trip in trips])
    time_gaps = np.array([trip.gap[0] for trip in trips]) / speeds
    return np.asarray(np.log([time_gaps, speeds]).mean(axis=1))


def conditional(mean: Floats, covariance: Floats, situation: Floats) -> tuple[Floats, Floats]:
    """Mean (P,) and covariance (P, P) of the parameters of drivers in this situation (2,)."""
    p = mean.size - situation.size
    slope = np.linalg.solve(covariance[p:, p:], covariance[p:, :p]).T
    spread = covariance[:p, :p] - slope @ covariance[p:, :p]
    return mean[:p] + slope @ (situation - mean[p:]), spread


def own_parameters(population: Population, trips: Sequence[Trip]) -> dict[int, Floats]:
    """The most probable parameters (P,) of each driver of a population."""
    mean, covariance = population.arrays
    found = {}
    for driver, own in of_drivers(trips).items():
        expected, spread = conditional(mean, covariance, situation_of(own))
        fitted = _Driver(MODELS[population.model], own, population.lag_s)
        errors = population.error, population.correlation_s
        found[driver] = np.exp(fitted.fit(expected, expected, spread, *errors)[0])
    return found


def best_lag(model: Model, trips: Sequence[Trip]) -> Fit:
    """The population with the most likely of `LAGS_S`."""
    fits = (fit_population(model, trips, lag) for lag in LAGS_S)
    return max(fits, key=lambda each: each.log_likelihood)


def pooled(model: Model, trips: Sequence[Trip], lag_s: float) -> Floats:
    """(P,) the one set of parameters that fits all trips best, as if one driver drove them."""
    return np.exp(_Driver(model, trips, lag_s).fit_alone(np.log(model.usual)))


def noise_of(fit: Fit, trips: Sequence[Trip]) -> tuple[float, float]:
    """Standard deviation, m/s2, and correlation time, s, of what drivers add to their models.

    Of an Ornstein-Uhlenbeck process with which the fitted drivers, in closed loop, have the
    recorded standard deviations of accelerations and of jerks (the method of simulated moments).
    Accelerations are means over 1 s, and jerks are their differences.
    """
    from scipy.optimize import minimize

    modes = dict(zip(fit.drivers, np.exp(fit.modes), strict=True))
    recorded = _moments([trip.speed[None] for trip in trips])

    def mismatch(logarithms: Floats) -> float:
        rng = np.random.default_rng(29)  # the same numbers for every noise
        speeds = []
        for trip in trips:
            p = np.tile(modes[trip.driver], (_REPETITIONS, 1))
            pushes = ou_noise(rng, (len(p), trip.gap.size), *np.exp(logarithms))
            speeds.append(drive(fit.model, trip, p, fit.lag_s, pushes)[1])
        return float((np.log(_moments(speeds) / recorded) ** 2).sum())

    bounds = [(np.log(low), np.log(high)) for low, high in NOISE_BOUNDS]
    options = {"xatol": 0.02, "fatol": 1e-4}
    start = np.log(NOISE_START)
    found = minimize(mismatch, start, method="Nelder-Mead", bounds=bounds, options=options)
    deviation, time_s = np.exp(found.x)
    return float(deviation), float(time_s)


def ou_noise(
    rng: np.random.Generator, shape: tuple[int, int], deviation: float, time_s: float
) -> Floats:
    """(M, n) stationary Ornstein-Uhlenbeck processes at 10 Hz."""
    from scipy.signal import lfilter

    kept = float(np.exp(-1 / RATE_HZ / time_s))
    steps = rng.normal(size=shape) * deviation * np.sqrt(1 - kept**2)
    steps[:, 0] /= np.sqrt(1 - kept**2)
    noise: Floats = lfilter([1.0], [1.0, -kept], steps, axis=1)
    return noise


def _moments(speeds: Sequence[Floats]) -> Floats:
    """(2,) standard deviations of accelerations and jerks of speeds [(M, n)] at 10 Hz."""
    accelerations = [np.diff(each[:, ::RATE_HZ], axis=1) for each in speeds]
    jerks = np.concatenate([np.diff(each, axis=1).ravel() for each in accelerations])
    return np.array([np.concatenate([each.ravel() for each in accelerations]).std(), jerks.std()])


class _Driver:
    """The trips of one driver."""

    def __init__(self, model: Model, trips: Sequence[Trip], lag_s: float) -> None:
        self._model, self._trips, self._lag_s = model, trips, lag_s

    def errors(self, mode: Floats) -> list[Floats]:
        """Logarithms of simulated over recorded gaps, twice per second, of each trip."""
        found = []
        for trip in self._trips:
            gaps, _ = drive(self._model, trip, np.exp(mode)[None], self._lag_s)
            found.append(np.log(np.clip(gaps[0], *_GAPS_M) / trip.gap)[::_EVERY])
        return found

    def fit_alone(self, usual: Floats) -> Floats:
        """The logarithms of the parameters with the smallest errors."""
        from scipy.optimize import least_squares

        bounds = usual - BOUND, usual + BOUND
        found = least_squares(lambda p: np.concatenate(self.errors(p)), usual, bounds=bounds)
        return np.asarray(found.x)

    def fit(
        self, start: Floats, mean: Floats, covariance: Floats, error: float, correlation_s: float
    ) -> tuple[Floats, Floats, float]:
        """The mode and the covariance of the posterior, and the log-evidence (Laplace)."""
        from scipy.optimize import least_squares

        weight = np.sqrt(_EVERY / RATE_HZ / correlation_s)
        whitened = np.linalg.inv(np.linalg.cholesky(covariance))

        def residuals(p: Floats) -> Floats:
            scaled = np.concatenate(self.errors(p)) * (weight / error)
            return np.concatenate([scaled, whitened @ (p - mean)])

        found = least_squares(residuals, start)
        information = found.jac.T @ found.jac
        independent = (found.fun.size - mean.size) * weight**2
        evidence = -found.cost - independent * np.log(error)
        evidence += np.log(np.diag(whitened)).sum() - np.linalg.slogdet(information)[1] / 2
        return found.x, np.linalg.inv(information), float(evidence)


def _spread(errors: Sequence[Sequence[Floats]]) -> tuple[float, float]:
    """Standard deviation and integrated correlation time in s of errors of trips of drivers."""
    trips = [trip for driver in errors for trip in driver]
    squares = sum(float(trip @ trip) for trip in trips)
    count = sum(trip.size for trip in trips)
    total = 1.0
    for lag in range(1, max(trip.size for trip in trips)):
        pairs = sum(max(trip.size - lag, 0) for trip in trips)
        products = sum(float(trip[lag:] @ trip[:-lag]) for trip in trips)
        correlation = products / pairs / (squares / count)
        if correlation <= 0.05:
            break
        total += 2 * correlation
    return float(np.sqrt(squares / count)), total * _EVERY / RATE_HZ
