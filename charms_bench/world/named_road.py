"""A road that is not the straight one: one of highway-env's, or one in a file."""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, JsonValue, ValidationInfo, model_validator

from charms_bench.errors import InputError
from charms_bench.foundation.fields import UNLESS_EMPTY, FilePath, FrozenModel, Name
from charms_bench.foundation.files import absolute, size_of

ENVIRONMENT = "environment"
"""The traffic model of the vehicles that a road has itself."""
FILE_ROAD = "road-file"
"""The environment of all roads in files."""
DRAWN, RECORDED, PLANNING_PROBLEM = STARTS = ("drawn", "recorded", "planning_problem")
"""Where the vehicles of a road in a file are at the start of an episode."""
ROAD_LIMIT_BYTES = 2**30
"""The largest file of a road or a map."""


def hash_of(path: Path) -> str:
    """The SHA-256 of a regular file; raises an `InputError` if it is too large or unreadable."""
    try:
        if size_of(path) > ROAD_LIMIT_BYTES:
            raise InputError(
                f"{path}: larger than {ROAD_LIMIT_BYTES:,} bytes; "
                "cut the map with the tools of its format"
            )
        with path.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


class NamedRoad(FrozenModel):
    """A road with its vehicles and the ego's goal: of an environment of highway-env, or a file."""

    name: Name
    """highway-env's name of the environment, such as `merge-v1`; with `file`, a name of its own, by
    default that of the file."""
    file: Annotated[FilePath | None, UNLESS_EMPTY] = None
    """A road file or a map that `charms-bench road` reads; a relative path starts at the folder of
    the suite."""
    sha256: Annotated[str | None, Field(pattern="^[0-9a-f]{64}$"), UNLESS_EMPTY] = None
    """The hash of the file, which is filled in when the file is first read."""
    configuration: Annotated[dict[str, JsonValue] | None, UNLESS_EMPTY] = None
    """Keys of highway-env's configuration, such as `{lanes_count: 3}`, or of a road in a file."""

    @model_validator(mode="before")
    @classmethod
    def _of_file(cls, value: Any, info: ValidationInfo) -> Any:
        """Fills in what a file decides."""
        file = value.get("file") if isinstance(value, dict) else None
        if not isinstance(file, str | Path):
            return value
        path = Path(file)
        found = {"name": path.name.partition(".")[0][:80] or "road", **value}
        if not found.get("sha256"):
            found["file"] = path = absolute((info.context or {}).get("folder", Path()) / path)
            try:
                found["sha256"] = hash_of(path)
            except InputError as error:
                raise ValueError(str(error)) from error
        return found

    def __str__(self) -> str:
        return self.name

    def __hash__(self) -> int:
        return hash((self.name, self.sha256, json.dumps(self.configuration, sort_keys=True)))

    @property
    def start(self) -> str:
        """One of `STARTS`."""
        return str((self.configuration or {}).get("start", DRAWN))

    @property
    def environment(self) -> str:
        """The environment to which the configuration belongs."""
        return FILE_ROAD if self.file else self.name
