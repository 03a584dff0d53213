"""Traffic of all eight styles, mixed by a Poisson cognitive hierarchy (PCH)."""

import math
from numbers import Real

from charms_agents.charms import STYLES, SVOS
from charms_bench.errors import InputError
from charms_bench.plugins.traffic import Mixture


class Pch(Mixture):
    """Draws the style of each vehicle independently, eq. 12 of the paper.

    Args:
        tau: Mean of the Poisson distribution over competitive, egoistic, prosocial and altruistic
            (0 to 3). Altruistic also takes the probability of all higher values.
        beta: Probability of an efficient style; otherwise the style is safe.

    Raises:
        InputError: `tau` is negative or not finite, or `beta` is not a probability.
    """

    def __init__(self, tau: float = 1.5, beta: float = 0.5) -> None:
        if not (_is_number(tau) and 0 <= tau < math.inf):
            raise InputError(f"traffic 'pch': tau must be 0 or more, got {tau!r}")
        if not (_is_number(beta) and 0 <= beta <= 1):
            raise InputError(f"traffic 'pch': beta must be from 0 to 1, got {beta!r}")
        poisson = [math.exp(-tau) * tau**k / math.factorial(k) for k in range(len(SVOS) - 1)]
        of_svo = dict(zip(SVOS, [*poisson, max(0.0, 1 - math.fsum(poisson))], strict=True))
        of_priority = {"efficient": beta, "safe": 1 - beta}
        super().__init__(
            {name: of_priority[style[0]] * of_svo[style[1]] for name, style in STYLES.items()}
        )


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
