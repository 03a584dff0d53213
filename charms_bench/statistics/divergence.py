"""Divergences between two distributions, both given as counts in the same bins.

Every function takes reference counts and other counts, both [..., K]. It returns [...], with NaN
where nothing was counted.
"""

import numpy as np

from charms_bench.world.scene import Floats

PSEUDO_COUNT = 0.5
"""Added to each bin before KL, because an empty bin makes KL infinite; Krichevsky & Trofimov 1981
(IEEE Transactions on Information Theory 27)."""


def kl_divergence(reference: Floats, other: Floats) -> Floats:
    """KL(reference || other) of the smoothed proportions, in nats.

    With human driving as the reference, it is large if humans do things that the other traffic
    never does, so a traffic that reproduces only one kind of driving scores badly. With more
    counts, missing kinds of driving weigh more, because smoothing hides less.
    """
    from scipy.special import rel_entr  # a run without references does without SciPy

    p, q = (_proportions(counts + PSEUDO_COUNT) for counts in (reference, other))
    return _defined(rel_entr(p, q).sum(axis=-1), reference, other)


def js_divergence(reference: Floats, other: Floats) -> Floats:
    """The Jensen-Shannon divergence in bits: 0 for the same proportions, 1 where no bin is shared.

    Lin 1991 (IEEE Transactions on Information Theory 37). The proportions are not smoothed, because
    this divergence is always finite.
    """
    from scipy.special import rel_entr

    p, q = _proportions(reference), _proportions(other)
    middle = (p + q) / 2
    nats = (rel_entr(p, middle) + rel_entr(q, middle)).sum(axis=-1) / 2
    return _defined(nats / np.log(2), reference, other)


def wasserstein(reference: Floats, other: Floats, width: float) -> Floats:
    """The first Wasserstein distance, in the unit of `width`.

    It is the average distance by which one distribution has to be moved to become the other. All
    values in a bin of that width count as equal.
    """
    between = _proportions(reference).cumsum(axis=-1) - _proportions(other).cumsum(axis=-1)
    return _defined(width * np.abs(between).sum(axis=-1), reference, other)


def _proportions(counts: Floats) -> Floats:
    total = counts.sum(axis=-1, keepdims=True)
    return np.asarray(counts / np.where(total > 0, total, 1.0))


def _defined(values: Floats, reference: Floats, other: Floats) -> Floats:
    counted = (reference.sum(axis=-1) > 0) & (other.sum(axis=-1) > 0)
    return np.where(counted, values, np.nan)
