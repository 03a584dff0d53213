"""Points in the space of a scenario's parameters: a grid, low-discrepancy points, or draws.

A point depends on its number and the scenario alone, so an episode's seed is its point's number.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.arrays import Floats
from charms_bench.world.scenario import LatinHypercube, Parameter, Scenario

DECIMALS = 6
"""Values are rounded, so that the last bits of a distribution's function do not matter."""
SOBOL_POINTS = 2**30
"""Those of SciPy's sequence."""
_STREAM = 2
"""The random stream of a seed that draws points; see `Simulation.reset` for another."""


def count_of(scenario: Scenario) -> int | None:
    """Returns the number of points; None if it has no end."""
    points = scenario.points
    if points == "grid":
        return math.prod(each.steps for each in scenario.parameters.values())
    if isinstance(points, LatinHypercube):
        return points.latin_hypercube
    if points == "sobol":
        return SOBOL_POINTS
    return len(points) if isinstance(points, tuple) else None


def values_at(scenario: Scenario, numbers: NDArray[Any]) -> dict[str, Floats]:
    """Returns the values of each parameter at points (R,), given by their numbers."""
    points, parameters = scenario.points, scenario.parameters
    if isinstance(points, tuple):
        return {name: np.array([points[int(n)][name] for n in numbers]) for name in parameters}
    if not parameters:
        return {}
    if points == "grid":
        values, rest = {}, numbers.astype(np.int64)
        for name, each in reversed(parameters.items()):  # the last parameter changes fastest
            rest, place = np.divmod(rest, each.steps)
            fraction = place / (each.steps - 1)
            values[name] = _rounded(each.range[0] + fraction * (each.range[1] - each.range[0]))
        return {name: values[name] for name in parameters}
    return from_unit_cube(parameters, _coordinates(scenario, numbers.astype(np.int64)))


def from_unit_cube(parameters: Mapping[str, Parameter], coordinates: Floats) -> dict[str, Floats]:
    """Returns the values of each parameter at points (R, P) of the unit cube."""
    return {
        name: _quantile(each, coordinates[:, k])
        for k, (name, each) in enumerate(parameters.items())
    }


def _quantile(parameter: Parameter, uniforms: Floats) -> Floats:
    low, high = parameter.range
    if parameter.normal is None:
        return _rounded(low + uniforms * (high - low))
    return _rounded(truncated_normal(uniforms, parameter.normal, parameter.range))


def truncated_normal(
    uniforms: Floats, normal: tuple[float, float], bounds: tuple[float, float]
) -> Floats:
    """The quantiles of a normal distribution, of a mean and a deviation, truncated to bounds."""
    from scipy.special import ndtr, ndtri

    (mean, deviation), (low, high) = normal, bounds
    first, last = ndtr((low - mean) / deviation), ndtr((high - mean) / deviation)
    drawn = mean + deviation * ndtri(first + uniforms * (last - first))
    return np.asarray(np.clip(drawn, low, high))


def _rounded(values: Floats) -> Floats:
    return np.asarray(np.round(values, DECIMALS))


def _coordinates(scenario: Scenario, numbers: NDArray[np.int64]) -> Floats:
    """Returns points (R, P) of the unit cube."""
    dimensions = len(scenario.parameters)
    if scenario.points == "random":
        draws = [np.random.default_rng([int(n), _STREAM]).random(dimensions) for n in numbers]
        return np.array(draws).reshape(-1, dimensions)
    if isinstance(scenario.points, LatinHypercube):
        return _latin_hypercube(dimensions, scenario.points.latin_hypercube)[numbers]
    first = int(numbers.min(initial=0)) if numbers.size == 0 else int(numbers.min())
    return sobol(dimensions, first, int(numbers.max(initial=0)) + 1 - first)[numbers - first]


def sobol(dimensions: int, first: int, count: int, scramble: int = 0) -> Floats:
    """Returns `count` points (R, P) of a scrambled Sobol sequence, from number `first` on."""
    from scipy.stats import qmc

    engine = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(scramble))
    if first:
        engine.fast_forward(first)
        return np.asarray(engine.random(count))
    # Asked for another number than a power of two, SciPy warns; later points are the same.
    return np.asarray(engine.random(2 ** max(0, count - 1).bit_length())[:count])


@lru_cache(maxsize=4)
def _latin_hypercube(dimensions: int, count: int) -> Floats:
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(dimensions, rng=np.random.default_rng(0)).random(count))
