"""The errors that users can cause; the command line prints their message and exits with 2.

CharmsBenchError
├── InputError          a file, name, option or value from outside is wrong
│   ├── SuiteError      a suite file; names file and line
│   ├── ScenarioError   a scenario cannot be placed; leads to the value in it
│   ├── RegistryError   a plugin is unknown, claimed twice or cannot be loaded
│   ├── ModelError      an ONNX file is missing, broken or of the wrong shape
│   ├── RunFolderError  a run folder cannot be read, written or continued
│   ├── DataError       recorded driving is missing, damaged or unusable
│   └── MapError        a road map cannot be read; names the element
├── AgentError          an agent raised an exception or returned something unusable
│   └── BrokenWordError  a plugin answered one question in two ways, or changed its input
└── WorkerError         a worker process died again and again, or took too long
    └── ClusterError    a cluster cannot be reached or used, or is gone
"""

import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails


ALL_METRICS = "`charms-bench show RUN --all` (docs/metrics.md)"
"""Where users find the names of metrics."""
_FEW, _NEAR = 20, 6
"""Names of a list that is printed whole, and of one that is not."""
TEXT_LIMIT = 500
"""Most characters of the text of a plugin's exception."""
PLUGIN_ERRORS = (Exception, SystemExit)
"""What a plugin may raise; Ctrl-C is not among these."""


class CharmsBenchError(Exception):
    """The base class of these errors; the text is the complete message.

    Addresses of objects are left out, because they differ from call to call.
    """

    def __init__(self, what: str = "") -> None:
        super().__init__(re.sub(r" at 0x[0-9a-fA-F]{6,}", "", what))


class InputError(CharmsBenchError):
    """A file, name, option or value from outside is wrong."""


class SuiteError(InputError):
    """A suite file cannot be run."""


class ScenarioError(InputError):
    """A scenario cannot be placed; `location` leads to the value in the scenario."""

    def __init__(self, location: Sequence[str | int], what: str) -> None:
        super().__init__(what)
        self.location = location

    def __reduce__(self) -> tuple[type["ScenarioError"], tuple[Sequence[str | int], str]]:
        """Workers send errors to the process that started them."""
        return type(self), (self.location, str(self))


class RegistryError(InputError):
    """A plugin cannot be found or loaded."""


class ModelError(InputError):
    """A model file cannot be used."""


class RunFolderError(InputError):
    """A run folder cannot be read, written or continued."""


class DataError(InputError):
    """Recorded driving cannot be read or used."""


class MapError(InputError):
    """A road map cannot be read or used."""


class AgentError(CharmsBenchError):
    """An agent raised an exception, or returned a wrong shape, type or value."""


class BrokenWordError(AgentError):
    """A plugin answered the same question in two ways, or changed what it was shown.

    Args:
        what: What it did.
        vehicle: The index of the vehicle among those of the call.
    """

    def __init__(self, what: str, vehicle: int = 0) -> None:
        super().__init__(what)
        self.vehicle = vehicle


class WorkerError(CharmsBenchError):
    """A worker process died again and again, or took too long."""


class ClusterError(WorkerError):
    """A cluster cannot be reached or used, or is gone."""


def raised(error: BaseException) -> str:
    """The text of a plugin's exception, and where it was raised."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})" if trace else ""
    return f"raised {named(error)}{where}"


def named(error: BaseException) -> str:
    """The type of a plugin's exception, and its text on one line if it has one."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # a plugin's exception can have any method
        text = "its text cannot be read"
    text = text if len(text) <= TEXT_LIMIT else text[: TEXT_LIMIT - 3] + "..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def suggestion(name: str, known: Mapping[str, object], listed: str = "") -> str:
    """The known names, and the one that a misspelt name probably means.

    If there are too many to read, only the nearest ones; `listed` says where all are listed.
    """
    longer = [each for each in known if name and each.startswith(f"{name}_")]
    folded = {each.casefold(): each for each in known}
    close = longer or [folded[each] for each in get_close_matches(name.casefold(), folded, n=1)]
    hint = f"Did you mean '{close[0]}'? " if close else ""
    if not listed or len(known) <= _FEW:
        return f"{hint}Known: {', '.join(known) or 'none'}."
    near = [each for each in known if name and name.casefold() in each.casefold()]
    near += [folded[each] for each in get_close_matches(name.casefold(), folded, _NEAR, cutoff=0.4)]
    nearest = ", ".join(list(dict.fromkeys([*close, *near]))[:_NEAR])
    return f"{hint}{f'Nearest: {nearest}. ' * bool(nearest)}{listed} has all {len(known)}."


def first_problem(error: "ValidationError") -> tuple[Sequence[str | int], str]:
    """The location and the description of the first problem that a model reports."""
    problems = _without_alternatives(error.errors(include_url=False))
    wrong = [each["loc"] for each in problems]
    # Pydantic also counts only the entries that are right.
    problems = [
        each
        for each in problems
        if each["type"] != "too_short"
        or not any(loc != each["loc"] == loc[: len(each["loc"])] for loc in wrong)
    ]
    first = problems[0]
    found = _shortened(first["input"])
    what = _plain(first["msg"])
    # A problem between several fields is not explained by printing all of them.
    is_whole = isinstance(first["input"], dict) and len(first["input"]) > 3
    if first["type"] not in ("missing", "unknown_key", "given_twice") and not is_whole:
        what = f"{what}, found {found}"
    others = [f"{'.'.join(map(str, each['loc']))}: {_plain(each['msg'])}" for each in problems[1:3]]
    others += [f"{len(problems) - 3} more"] if len(problems) > 3 else []
    return first["loc"], "; also ".join([what, *others])


_ALTERNATIVE = re.compile(r"constrained-\w+|[\w-]+\[.*\]")
"""What pydantic calls an alternative of a union in the location of a problem."""


def _without_alternatives(problems: "list[ErrorDetails]") -> "list[ErrorDetails]":
    """The problems of each union's likeliest alternatives, and all others, without their names."""
    unions: dict[tuple[int | str, ...], list[ErrorDetails]] = {
        each["loc"][:k]: []
        for each in problems
        for k, part in enumerate(each["loc"])
        if _ALTERNATIVE.fullmatch(str(part))
    }
    for each in problems:
        loc = each["loc"]
        union = next((loc[:k] for k in range(len(loc)) if loc[:k] in unions), None)
        each["loc"] = tuple(
            part for k, part in enumerate(loc) if loc[:k] not in unions and part != "[key]"
        )
        if union is not None:
            unions[union].append(each)
    unlikely = set()
    for place, several in unions.items():
        likely = [each for each in several if each["loc"] != place or not _is_of_type(each)]
        if several and not likely:
            others = (each["msg"].removeprefix("Input should be") for each in several[1:])
            several[0]["msg"] = " or".join([several[0]["msg"], *others])
            likely = several[:1]
        unlikely |= {id(each) for each in several} - {id(each) for each in likely}
    return [each for each in problems if id(each) not in unlikely]


def _is_of_type(problem: "ErrorDetails") -> bool:
    return problem["type"].endswith("_type") or problem["type"] == "literal_error"


def problem_in(error: Exception) -> str:
    """The first problem that a model reports, and where, or the text of another error."""
    from pydantic import ValidationError

    if not isinstance(error, ValidationError):
        return " ".join(str(error).split())
    location, what = first_problem(error)
    return f"{'.'.join(map(str, location))}: {what}".removeprefix(": ")


def _plain(message: str) -> str:
    """A message of pydantic without the names of Python's classes."""
    message = message.removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = re.sub(
        r"\w+ should have at least (\d+) items? after validation, not \d+",
        r"expected at least \1",
        message,
    )
    message = message.replace("a valid tuple", "a list")
    return re.sub(
        r"dictionary( or (an )?instance of \w+| or object to extract.*)", "mapping", message
    )


def _shortened(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
