"""A finished part of an estimation or a search: a JSON file that holds its own checksum."""

import hashlib
import json
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

from charms_bench.foundation.files import json_of, read_limited, write_bytes

T = TypeVar("T")
FILE_LIMIT_BYTES = 2**26


def write_result(path: Path, result: Any) -> None:
    """Writes a result, which JSON can hold."""
    text = json.dumps(result)
    checked = {"sha256": hashlib.sha256(text.encode()).hexdigest(), "run": text}
    write_bytes(path, json.dumps(checked).encode())


def read_result(path: Path, kind: TypeAdapter[T]) -> T | None:
    """Returns a result, or None if it is missing or has changed since it was written."""
    try:
        checked = json_of(read_limited(path, FILE_LIMIT_BYTES))
        text = checked["run"]
        if hashlib.sha256(text.encode()).hexdigest() != checked["sha256"]:
            return None
        return kind.validate_json(text)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
