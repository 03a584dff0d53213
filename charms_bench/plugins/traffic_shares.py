"""The shares of the agents that a traffic assigns, counted among many vehicles."""

import numpy as np

from charms_bench.errors import PLUGIN_ERRORS, AgentError, BrokenWordError, raised
from charms_bench.plugins.traffic import Traffic, assigned

SAMPLED = 200_000
"""Vehicles that are assigned: the standard error of a share is at most 0.11 %."""
_PER_SCENE = 20


def shares(traffic: Traffic) -> dict[str, float]:
    """Each agent's share of `SAMPLED` vehicles, in the traffic's order."""
    rng = np.random.default_rng(0)
    try:
        names = assigned(traffic, rng, SAMPLED // _PER_SCENE, _PER_SCENE)
    except BrokenWordError as error:
        raise AgentError(f"the traffic: {error}") from error
    except PLUGIN_ERRORS as error:
        raise AgentError(f"the traffic {raised(error)}") from error
    return {name: float((names == name).mean()) for name in traffic.agents}
