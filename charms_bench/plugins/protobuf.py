"""Reads Protocol Buffers, the format of ONNX files.

A message is a sequence of fields; each has a number, a kind and a value, and a value can be a
message itself. https://protobuf.dev/programming-guides/encoding/
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

Value = int | memoryview
"""The value of a field: a number, or the bytes of anything else."""
FIELDS_LIMIT = 1_000_000
"""Most fields of a file, in all messages together; a network of ten layers has about 300."""


class TooManyFieldsError(ValueError):
    """A file has more than `FIELDS_LIMIT` fields."""


class Reader:
    """Reads the messages of a file, which may have a limited number of fields."""

    def __init__(self) -> None:
        self._left = FIELDS_LIMIT

    def read(self, message: memoryview, schema: Mapping[int, Any]) -> dict[str, list[Any]]:
        """The values of the fields that a schema names, by name, in their order.

        The schema has by the number of a field its name; or its name and the schema of the messages
        that are its values.

        Raises:
            ValueError, IndexError: It is not a message, or a field has another kind of value.
        """
        found: dict[str, list[Any]] = defaultdict(list)
        for number, value in self._fields(message):
            match schema.get(number):
                case str(name):
                    found[name].append(value)
                case (name, inner):
                    found[name].append(self.read(_bytes_of(value), inner))
        return found

    def _fields(self, message: memoryview) -> Iterator[tuple[int, Value]]:
        """The number and value of each field."""
        at = 0
        while at < len(message):
            tag, at = varint(message, at)
            number, kind = tag >> 3, tag & 7
            value: Value
            if kind == 0:
                value, at = varint(message, at)
            elif kind in (1, 5):
                size = 8 if kind == 1 else 4
                value, at = message[at : at + size], at + size
            elif kind == 2:
                size, at = varint(message, at)
                value, at = message[at : at + size], at + size
            else:
                raise ValueError(f"field {number} is of the kind {kind}")
            if at > len(message) or not 0 < number < 2**29:
                raise ValueError(f"field {number} is cut short")
            self._left -= 1
            if self._left < 0:
                raise TooManyFieldsError
            yield number, value


def varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number with seven bits per byte, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & (2**64 - 1), at
    raise ValueError("a number without end")


def text_of(value: Value) -> str:
    """The value of a field that must be a text."""
    return bytes(_bytes_of(value)).decode(errors="replace")


def _bytes_of(value: Value) -> memoryview:
    if isinstance(value, int):
        raise ValueError("a number, expected a message or a text")
    return value
