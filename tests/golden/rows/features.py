"""What features make that no suite has; see the modules."""

from importlib.util import find_spec

from rows import environments, episodes, people, simulations

CASES = environments.CASES | simulations.CASES | episodes.CASES | people.CASES


def lacks(name: str) -> str:
    """Returns the module that a case needs and that is not installed; empty if there is none."""
    module = next((each for each in ("minari", "pettingzoo") if name.startswith(each)), "")
    return "" if not module or find_spec(module) else module
