"""Finds out whether a plugin has changed the harness or the arithmetic of its process."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from operator import is_
from types import ModuleType

import numpy as np

_BOOKKEEPING = ("__warningregistry__", "__annotations__", "__abstractmethods__")
"""Names that Python sets by itself."""
Names = Sequence[tuple[str, Mapping[str, object], Mapping[str, object]]]
"""Modules and classes of the harness: the name of each, its names now, and a copy of them."""


def harness_names() -> Names:
    """What every name in the modules of this package that are imported stands for."""
    return [
        (where, names, dict(names))
        for name, module in _whole_modules()
        for where, names in _namespaces(name, module)
    ]


def _whole_modules() -> Iterator[tuple[str, ModuleType]]:
    """The imported modules of this package, by name.

    Another thread may still be importing one, which would change its names afterwards.
    `import_module` waits for the end of that import.
    """
    for name in [name for name in list(sys.modules) if f"{name}.".startswith("charms_bench.")]:
        with suppress(ImportError):  # one that cannot be imported changes nothing
            yield name, import_module(name)


def _namespaces(name: str, module: ModuleType) -> Iterator[tuple[str, Mapping[str, object]]]:
    """The names of a module, and those of each class that it defines."""
    yield name, vars(module)
    for value in list(vars(module).values()):
        if isinstance(value, type) and value.__module__ == name:
            yield f"{name}.{value.__qualname__}", vars(value)


def problem_of(before: Names) -> str:
    """What has changed since `harness_names`, or is wrong with the arithmetic; else empty."""
    for where, names, then in before:
        if names.keys() == then.keys() and all(map(is_, names.values(), then.values())):
            continue  # so it is nearly always, and this is quicker
        for name, value in then.items():
            if names.get(name) is not value and name not in _BOOKKEEPING:
                return f"a plugin has replaced {where}.{name} of the harness"
    if not _rounds_to_nearest():
        return "a plugin or its libraries have changed how the processor rounds"
    if not _keeps_small_numbers():
        return "a plugin or its libraries make the processor treat very small numbers as 0"
    return ""


def _rounds_to_nearest() -> bool:
    """IEEE 754: the nearest double to 1/3 lies below it, and that to 2/3 above it."""
    third = np.array([1.0, -1.0, 2.0, -2.0]) / np.array([3.0, 3.0, 3.0, 3.0])
    below, above = float.fromhex("0x1.5555555555555p-2"), float.fromhex("0x1.5555555555555p-1")
    return bool(third.tolist() == [below, -below, above, -above])


def _keeps_small_numbers() -> bool:
    """Flush-to-zero and denormals-are-zero, which code compiled with `-ffast-math` sets."""
    smallest = np.array([sys.float_info.min])
    denormal = smallest * 0.5
    return bool(0.0 < denormal[0] < smallest[0] == denormal[0] * 2.0)
