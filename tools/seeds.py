"""Values of training seeds: their mean with Student's t interval, the worst."""

from collections.abc import Callable

import numpy as np
from scipy import special

from charms_bench.report.number import Number
from charms_bench.statistics.intervals import CONFIDENCE
from charms_bench.world.scene import Floats

SEED = ", seed "
"""Stands between the label of a training configuration and its seed."""
Worst = Callable[[Floats], float]
Columns = dict[str, tuple[str, str, Worst | None]]
"""Header and format of each metric, and which of the seeds' values is the worst, if any is."""


def mean_of(values: Floats, low: float = -np.inf, high: float = np.inf) -> Number:
    """The mean of seeds with its interval, if there are several, cut to what values can be."""
    n = len(values)
    if n < 2:
        return Number(float(values.mean()) if n else None, n=n)
    mean, t = values.mean(), special.stdtrit(n - 1, (1 + CONFIDENCE) / 2)
    margin = t * values.std(ddof=1) / np.sqrt(n)
    return Number(mean, max(mean - margin, low), min(mean + margin, high), n)
