"""Reads a name with options, such as `standard:ttc_s=2`."""

from typing import Any

from charms_bench.errors import InputError
from charms_bench.runs.document import value_of


def name_and_options(text: str, what: str) -> tuple[str, dict[str, Any]]:
    """Returns the name and the options of a text like `NAME` or `NAME:OPTION=VALUE,...`.

    Args:
        text: The text.
        what: What messages call the thing that it names, such as `metric set`.

    Raises:
        InputError: The text is not of that form.
    """
    name, _, given = text.partition(":")
    options = {}
    for part in filter(None, given.split(",")):
        key, equals, value = part.partition("=")
        if not equals or not key.isidentifier():
            raise InputError(f"{what} '{text}': expected NAME:OPTION=VALUE, found '{part}'")
        if key in options:
            raise InputError(f"{what} '{text}': {key} is given twice")
        try:
            options[key] = value_of(value)
        except ValueError as error:
            raise InputError(f"{what} '{name}': {key}: cannot be read: {error}") from error
    return name, options
