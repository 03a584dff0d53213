"""What can go wrong through no bug of ours.

    CharmsBenchError
    ├── InputError          a file, name, option or value from outside is wrong
    │   ├── SuiteError      a suite file; names file and line
    │   ├── RegistryError   a plugin is unknown, claimed twice or cannot be loaded
    │   ├── ModelError      an ONNX file is missing, broken or of the wrong shape
    │   ├── RunFolderError  a run folder cannot be read, written or continued
    │   └── DataError       recorded driving is missing, damaged or of no use
    ├── AgentError          an agent raised or answered with something unusable
    └── WorkerError         a worker process died again and again, or took too long
        └── ClusterError    a cluster cannot be reached or used, or is gone

The command line prints the message of any of these and exits with 2.
"""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic import ValidationError


class CharmsBenchError(Exception):
    """The base of every error a user can cause; its text is the whole message."""


class InputError(CharmsBenchError):
    """Something from outside is wrong: what, where, what was expected, what to do."""


class SuiteError(InputError):
    """A suite file does not say something that can be run."""


class RegistryError(InputError):
    """A plugin cannot be found or loaded."""


class ModelError(InputError):
    """A model file cannot be used."""


class RunFolderError(InputError):
    """A run folder cannot be read, written or continued."""


class DataError(InputError):
    """Recorded driving cannot be read or learnt from."""


class AgentError(CharmsBenchError):
    """An agent raised, or returned the wrong shape, type or range."""


class WorkerError(CharmsBenchError):
    """A worker process died again and again, or took too long."""


class ClusterError(WorkerError):
    """A cluster cannot be reached or used, or is gone."""


def suggestion(name: str, known: Mapping[str, object]) -> str:
    """What to say to whoever misspelt one of the known names."""
    close = get_close_matches(name, known, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    return f"Known: {', '.join(known) or 'none'}.{hint}"


def first_problem(error: "ValidationError") -> tuple[Sequence[str | int], str]:
    """Where the first thing stands that a model finds wrong, and what to say of it."""
    problems = error.errors(include_url=False)
    first = problems[0]
    found = _shortened(first["input"])
    what = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        what = "unknown key"
    elif first["type"] != "missing":
        what = f"{what}, found {found}"
    more = f" ({len(problems) - 1} more)" if len(problems) > 1 else ""
    return first["loc"], what + more


def _shortened(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
