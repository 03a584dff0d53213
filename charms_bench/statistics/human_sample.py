"""The sampling error of few recorded drivers, whose counts come in independent units.

A unit is a recording or a vehicle: values of one driver depend on each other, and so do those of
drivers in the same traffic jam.
"""

import numpy as np

from charms_bench.statistics.intervals import CONFIDENCE, NO_BOUNDS, RESAMPLES, Bounds
from charms_bench.world.scene import Floats


def perfect_samples(units: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """The smoothed distribution [K] of the humans, and samples of it as small as that of them.

    The samples [RESAMPLES, K] are counts of as many units as were recorded.

    It is the smoothed bootstrap (Silverman & Young 1987, Biometrika 74): each unit is drawn at
    random and moved as a whole by a normal deviate. Without smoothing, a truth that consists of a
    few recorded values would seem easy to hit. The bandwidth is Silverman's rule of thumb for the
    means of units.

    Args:
        units: [U, K] counts, U > 1; values beyond either end count in the last bin there.
        rng: Of the samples.
    """
    count, bins = units.shape
    places = np.arange(bins)
    means = units @ places / units.sum(axis=1)
    bandwidth = max(1.06 * float(means.std(ddof=1)) * count**-0.2, 1e-9)
    kernel = np.exp(-((places[:, None] - places) ** 2) / (2 * bandwidth**2))
    truth = (units.sum(axis=0) / units.sum()) @ (kernel / kernel.sum(axis=1, keepdims=True))
    samples = np.empty((RESAMPLES, bins))
    for sample in samples:
        drawn = units[rng.integers(count, size=count)]
        moved = np.rint(rng.normal(0.0, bandwidth, (count, 1))).astype(np.int64)
        at = np.clip(places + moved, 0, bins - 1)
        sample[:] = np.bincount(at.ravel(), drawn.ravel(), minlength=bins)
    return truth, samples


def around(value: float, resampled: Floats, units: int) -> Bounds:
    """The 95 % interval of a distance from so few humans, from resamples of their units.

    Resamples repeat units, so their distances are larger on average. This bias is taken out: the
    interval is that of the distance expected with as many humans. The deviations are widened as the
    standard error of a mean is with Student's t (Hesterberg 2015, The American Statistician 69).
    There is no interval with a single unit.
    """
    from scipy import special

    resampled = resampled[~np.isnan(resampled)]
    if units < 2 or not resampled.size:
        return NO_BOUNDS
    upper = (1 + CONFIDENCE) / 2
    widened = special.stdtrit(units - 1, upper) / special.ndtri(upper)
    deviations = np.quantile(resampled, [1 - upper, upper]) - resampled.mean()
    low, high = value + deviations * widened * np.sqrt(units / (units - 1))
    return max(float(low), 0.0), float(high)
