"""Holds a plugin against its contract, in a worker: what it does to its process harms no other."""

from typing import NamedTuple

from charms_bench.errors import PLUGIN_ERRORS, raised
from charms_bench.foundation.workers import tell
from charms_bench.plugins.registry import AGENTS, TRAFFIC, make_agent, make_traffic, plugins
from charms_bench.testing.contract import agent_rules, traffic_rules
from charms_bench.testing.driving import remark_on


class Found(NamedTuple):
    """A rule, and the problem with it; empty without one."""

    rule: str
    problem: str


def check(name: str) -> str:
    """Tells the parent what was `Found` of each rule; returns a remark, see `remark_on`.

    Raises a `CharmsBenchError` if there is no such plugin, or it cannot be made.
    """
    is_traffic = name in plugins(TRAFFIC) and name not in plugins(AGENTS)
    passes = True
    for rule in traffic_rules(make_traffic(name)) if is_traffic else agent_rules(make_agent(name)):
        problem = ""
        try:
            rule()
        except PLUGIN_ERRORS as error:  # every mistake of a plugin is a result of the check
            problem = str(error) if isinstance(error, AssertionError) else raised(error)
        passes = passes and not problem
        tell(Found(rule.__name__.replace("_", " "), problem))
    return remark_on(name) if passes and not is_traffic else ""
