"""Standardised observations, in which typical differences are of order 1.

Plain observations divide speeds by 66 m/s. Two vehicles that approach each other at 5 m/s differ
by 0.08, and a network learns slowly from such small differences. Standardised, they differ by 0.8.
"""

from copy import deepcopy

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import Linear, Sequential

from charms_bench.world.interaction_observation import FIRST_CONFLICT, FIRST_NEIGHBOUR
from charms_bench.world.observations import (
    CHANGE_SCALE,
    COMMANDS,
    EGO,
    SPEED_SCALE_MPS,
    X_SCALE_M,
    Y_SCALE_M,
)

ROWS, COLUMNS = 8, 5
"""Of `neighbours` with the option `commands`; without it, there are only the first 7 rows."""
PRESENCE, X, Y, VX, VY = range(COLUMNS)
DISTANCE_M, LANE_M, SPEED_MPS, LATERAL_MPS = 40.0, 4.0, 6.0, 3.0
"""The units: distance along and across the road, speed along and across the road."""
EGO_Y_M, EGO_SPEED_MPS = 4.0, 28.0
"""The zeros of the ego's own row: the middle of three lanes, a typical speed."""
COMMANDED_MPS, COMMANDED_MPS2 = 1.0, 3.0
"""The units of the row `COMMANDS`: the change of speed that is left, and the acceleration."""


def _units() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Factors (40,) and offsets (40,): standardised = observed * factor + offset."""
    factors = np.ones((ROWS, COLUMNS), dtype=np.float32)
    factors[:, X] = X_SCALE_M / DISTANCE_M
    factors[:, Y] = Y_SCALE_M / LANE_M
    factors[:, VX] = SPEED_SCALE_MPS / SPEED_MPS
    factors[:, VY] = SPEED_SCALE_MPS / LATERAL_MPS
    factors[EGO, [PRESENCE, X]] = 0.0  # these are always 1
    factors[COMMANDS] = CHANGE_SCALE / COMMANDED_MPS, 1, 1, CHANGE_SCALE / COMMANDED_MPS2, 0
    offsets = np.zeros((ROWS, COLUMNS), dtype=np.float32)
    offsets[EGO, Y] = -EGO_Y_M / LANE_M
    offsets[EGO, VX] = -EGO_SPEED_MPS / SPEED_MPS
    return factors.ravel(), offsets.ravel()


FACTORS, OFFSETS = (torch.from_numpy(array) for array in _units())
_OF_EGO = 2.0, 3.0, 1.0, 3.0, 1.0, 4.0, 3.0, 2.0
_OF_WAY = 1.0, 1.0, 3.0, 2.0, 2.0, 3.0, 3.0, 3.0
_OF_NEIGHBOURS = 1.0, 3.0, 3.0, 2.0, 2.0, 2.0, 2.0, 2.0
_OF_CONFLICTS = 1.0, 3.0, 3.0, 3.0, 3.0, 1.0, 1.0, 3.0
"""Factors of the rows of `interaction`, whose numbers are of order 1 before."""


def _factors(inputs: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Factors and offsets of the first `inputs` numbers of an observation."""
    if inputs <= ROWS * COLUMNS:
        return FACTORS[:inputs], OFFSETS[:inputs]
    conflicts = inputs // len(_OF_EGO) - FIRST_CONFLICT
    neighbours = FIRST_CONFLICT - FIRST_NEIGHBOUR
    factors = (*_OF_EGO, *_OF_WAY, *_OF_NEIGHBOURS * neighbours, *_OF_CONFLICTS * conflicts)
    return torch.tensor(factors), torch.zeros(inputs)


def standardise(observations: torch.Tensor) -> torch.Tensor:
    """Observations (..., 35) or, with commands, (..., 40), or those of junctions, standardised."""
    factors, offsets = _factors(observations.shape[-1])
    return observations * factors + offsets


def folded(network: Sequential, given: int = 0) -> Sequential:
    """Turns a network for standardised observations into an equal one for plain observations.

    The last `given` inputs of both are numbers of another kind.
    """
    result = deepcopy(network)
    first = result[0]
    assert isinstance(first, Linear)
    seen = first.in_features - given
    factors, offsets = _factors(seen)
    with torch.no_grad():
        first.bias.add_(first.weight[:, :seen] @ offsets)
        first.weight[:, :seen].mul_(factors)
    return result


def unfolded(network: Sequential) -> Sequential:
    """The network for standardised observations that `folded` turns into this network.

    Weights of inputs that standardise to 0 have no effect, and are 0.
    """
    result = deepcopy(network)
    first = result[0]
    assert isinstance(first, Linear)
    factors, offsets = _factors(first.in_features)
    with torch.no_grad():
        first.weight.copy_(torch.where(factors == 0, 0, first.weight / factors))
        first.bias.sub_(first.weight @ offsets)
    return result
