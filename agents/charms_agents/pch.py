"""Traffic of all eight styles, mixed by a Poisson cognitive hierarchy (PCH)."""

import math
from collections.abc import Mapping
from numbers import Real

from charms_agents.charms import FAMILIES, STYLES, SVOS, agents_of
from charms_bench import Mixture
from charms_bench.errors import InputError, suggestion


class Pch(Mixture):
    """Draws the style of each vehicle independently, eq. 12 of the paper.

    Args:
        tau: Mean of the Poisson distribution over competitive, egoistic, prosocial and altruistic
            (0 to 3). Altruistic also takes the probability of all higher values.
        beta: Probability of an efficient style; otherwise the style is safe.
        styles: The agents that drive in these styles, such as `{safe-egoistic: mine.onnx}`. CHARMS
            drives in the other styles.
        family: `charms`, the agents of the straight road, or `charms-roads`, those of all roads.

    Raises:
        InputError: `tau` is negative or not finite, `beta` is not a probability, or `styles` or
            `family` names something else.
    """

    def __init__(
        self,
        tau: float = 1.5,
        beta: float = 0.5,
        styles: Mapping[str, str] | None = None,
        family: str = "charms",
    ) -> None:
        if not (_is_number(tau) and 0 <= tau < math.inf):
            raise InputError(f"traffic 'pch': tau must be 0 or more, got {tau!r}")
        if not (_is_number(beta) and 0 <= beta <= 1):
            raise InputError(f"traffic 'pch': beta must be from 0 to 1, got {beta!r}")
        if family not in FAMILIES:
            known = f"expected {' or '.join(FAMILIES)}, got {family!r}"
            raise InputError(f"traffic 'pch': family: {known}")
        poisson = [math.exp(-tau) * tau**k / math.factorial(k) for k in range(len(SVOS) - 1)]
        of_svo = dict(zip(SVOS, [*poisson, max(0.0, 1 - math.fsum(poisson))], strict=True))
        of_priority = {"efficient": beta, "safe": 1 - beta}
        own = {"-".join(style): name for name, style in agents_of(family).items()}
        agents = own | _checked(styles or {})
        composition = dict.fromkeys(agents.values(), 0.0)
        for priority, svo in STYLES.values():  # one agent may drive in several styles
            composition[agents[f"{priority}-{svo}"]] += of_priority[priority] * of_svo[svo]
        super().__init__(composition)


def _checked(styles: object) -> dict[str, str]:
    """The agents given for styles."""
    known = {"-".join(style): style for style in STYLES.values()}
    if not isinstance(styles, Mapping):
        raise InputError(f"traffic 'pch': styles must be a mapping of styles to agents: {styles!r}")
    for style, agent in styles.items():
        if style not in known:
            raise InputError(f"traffic 'pch': no style {style!r}. {suggestion(str(style), known)}")
        if not isinstance(agent, str):
            raise InputError(f"traffic 'pch': {style} must be an agent's name, got {agent!r}")
    return dict(styles)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
