"""Input for the command line from somebody hostile, or unlucky."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

CANARY = "canary"
"""A folder that hostile input tries to make, by running code, in the working directory."""


class BadInput(NamedTuple):
    """Input that has to be rejected."""

    title: str
    make: Callable[[Path], Sequence[object]]
    """Writes its files into a folder and returns the command line, run in that folder."""
    said: str = ""
    """Words of the message."""
