"""The temperature T at which softmax(Q / T) is a network's distribution over the actions."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax

COLDEST, HOTTEST = 1e-3, 1e3
"""The limits of a fitted temperature; a network that predicts worse than chance is given HOTTEST,
at which all actions are equally probable."""


def log_likelihood(
    values: NDArray[np.float32], labels: NDArray[np.float32], temperature: float
) -> float:
    """Mean over rows of the sum of y log softmax(Q / T), for values and labels (M, A)."""
    log_p = log_softmax(values.astype(np.float64) / temperature, axis=1)
    return float((labels * log_p).sum(axis=1).mean())


def fitted_temperature(values: NDArray[np.float32], labels: NDArray[np.float32]) -> float:
    """The temperature at which the labels (M, A) are the most likely, given the values (M, A).

    The log-likelihood is concave in 1 / T, so its only maximum over log T is found.
    """
    found = minimize_scalar(
        lambda log_t: -log_likelihood(values, labels, math.exp(log_t)),
        bounds=(math.log(COLDEST), math.log(HOTTEST)),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return math.exp(found.x)
