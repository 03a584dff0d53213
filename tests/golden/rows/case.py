"""Cases: functions that return values by name."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

Values = dict[str, Any]
Case = Callable[[Path], Values]
"""A function that is given an empty folder and returns hashes, and a few values to read."""
Cases = dict[str, Case]


def adding_to(cases: Cases) -> Callable[[str], Callable[[Case], Case]]:
    """Returns a decorator that adds a function to cases under a name."""

    def named(name: str) -> Callable[[Case], Case]:
        def add(function: Case) -> Case:
            cases[name] = function
            return function

        return add

    return named
