"""The energy score: the distance of an observation from a predicted distribution."""

import numpy as np

from charms_bench.world.scene import Floats


def energy_score(draws: Floats, observed: Floats) -> Floats:
    """(S,) energy scores of S predictions: draws (S, M, D) against what was observed (S, D).

    The mean distance of the draws from the observation, minus half of their mean distance from each
    other (Gneiting & Raftery 2007, eq. 22, with the estimate of Ferro 2014 that does not depend on
    M). It is smallest in expectation for the true distribution. One draw is a point.
    """
    distance = np.linalg.norm(draws - observed[:, None], axis=-1).mean(axis=1)
    count = draws.shape[1]
    if count == 1:
        return np.asarray(distance)
    apart = np.zeros(len(draws))
    for shift in range(1, count // 2 + 1):
        between = np.linalg.norm(draws - np.roll(draws, shift, axis=1), axis=-1).mean(axis=1)
        # Rolled by half of an even count, every pair is met twice.
        apart += between if 2 * shift == count else 2 * between
    return np.asarray(distance - apart / (count - 1) / 2)
