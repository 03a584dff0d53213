"""What the functions of the Python interface take."""

from pathlib import Path

from charms_bench.errors import InputError

PathLike = str | Path


def check_positive(**options: float | None) -> None:
    """Refuses options that are given and not above 0.

    Raises:
        InputError: One of them is not above 0.
    """
    for name, value in options.items():
        if value is not None and value <= 0:
            raise InputError(f"{name} is {value}; expected a number above 0")
