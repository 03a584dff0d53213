"""Events in standard normal space whose probability is known.

Each makes a level function of D components, at most 0 with a given probability, which scipy's
distributions give in closed form or as an integral over one component.
"""

from collections.abc import Callable

import numpy as np
from scipy import integrate, optimize, stats

from charms_bench.statistics.subset_simulation import Level, Seeds
from charms_bench.world.scene import Floats

DIMENSION = 24


def linear(probability: float) -> Level:
    """All components weigh the same: beta - sum u / sqrt(D)."""
    beta = stats.norm.isf(probability)
    return lambda normal, seeds: beta - _along(normal)


def parabolic(probability: float) -> Level:
    """The boundary curves away from the origin: beta + w**2 / 2 - sum u / sqrt(D)."""

    def excess(beta: float) -> float:
        found, _ = integrate.quad(
            lambda w: stats.norm.pdf(w) * stats.norm.sf(beta + w**2 / 2), -10, 10, epsabs=1e-16
        )
        return float(np.log(found) - np.log(probability))

    beta = optimize.brentq(excess, 0.0, 8.0)
    return lambda normal, seeds: beta + (normal[:, 0] - normal[:, 1]) ** 2 / 4 - _along(normal)


def two_sided(probability: float) -> Level:
    """A series system of two components that fail far from each other: beta - |sum u / sqrt(D)|."""
    beta = stats.norm.isf(probability / 2)
    return lambda normal, seeds: beta - np.abs(_along(normal))


def sphere(probability: float) -> Level:
    """Every direction fails alike: the norm of u exceeds a radius."""
    radius = np.sqrt(stats.chi2.isf(probability, DIMENSION))
    return lambda normal, seeds: radius - np.sqrt((normal**2).sum(axis=1))


def stepped(probability: float) -> Level:
    """A level with flat parts: the linear one, rounded up to tenths."""
    exact = linear(probability)
    return lambda normal, seeds: np.ceil(exact(normal, seeds) * 10) / 10


def seeded(probability: float) -> Level:
    """One seed in ten is bad, and brings the linear event nearer by 1."""

    def excess(beta: float) -> float:
        found = 0.1 * stats.norm.sf(beta) + 0.9 * stats.norm.sf(beta + 1)
        return float(np.log(found) - np.log(probability))

    beta = optimize.brentq(excess, 0.0, 8.0)
    return lambda normal, seeds: beta - _along(normal) + (seeds >= 2**63 // 10)


def jump(probability: float) -> Level:
    """The level stays the same below a half-space, and a tenth of the half-space has the event."""
    edge, last = stats.norm.isf(probability * 10), stats.norm.isf(0.1)

    def level(normal: Floats, seeds: Seeds) -> Floats:
        happens = (normal[:, 0] >= edge) & (normal[:, 1] >= last)
        return np.where(happens, 0.0, np.maximum(edge - normal[:, 0], 0.0) + 0.5)

    return level


def _along(normal: Floats) -> Floats:
    return np.asarray(normal.sum(axis=1) / np.sqrt(normal.shape[1]))


PROBLEMS: dict[str, Callable[[float], Level]] = {
    each.__name__: each for each in (linear, parabolic, two_sided, sphere, stepped, seeded, jump)
}
