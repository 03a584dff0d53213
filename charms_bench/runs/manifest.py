"""What a folder with a manifest holds: it is compared before anything in the folder is changed."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from charms_bench.errors import RunFolderError, first_problem
from charms_bench.foundation.files import PARTIAL, json_of, read_file, write_bytes
from charms_bench.runs.lock import locked
from charms_bench.runs.suite import Suite

MANIFEST_LIMIT_BYTES = 2**24
"""Twenty times the largest manifest; JSON takes fifty times its size in memory."""


class RunFields(BaseModel):
    """The types of the fields of a run's manifest; its suite is validated as a suite."""

    model_config = ConfigDict(strict=True, extra="allow")

    charms_bench: str = ""
    suite_sha256: str = ""
    agents: dict[str, dict[str, str]] = {}
    metric_sets: dict[str, int] = {}
    versions: dict[str, str] = {}
    commit: str = ""
    modules: dict[str, str] = {}
    machine: dict[str, str | int | None] = {}


def check_fields(path: Path, manifest: dict[str, Any]) -> None:
    """Raises a `RunFolderError` that names the first field of a run's manifest of another type."""
    try:
        RunFields.model_validate(manifest)
    except ValidationError as error:
        place, what = first_problem(error)
        raise RunFolderError(f"{path}: {'.'.join(map(str, place))}: {what}") from error


def read_manifest(path: Path) -> Any:
    """The content of a manifest; raises a `RunFolderError` if it is not JSON or too large."""
    try:
        return json_of(read_file(path, MANIFEST_LIMIT_BYTES))
    except ValueError as error:
        raise RunFolderError(f"{path}: is not JSON: {error}") from error


@contextmanager
def opened(
    folder: Path, manifest: str, kind: str, ours: Mapping[str, Any], read: Callable[[], Any]
) -> Iterator[None]:
    """Locks a folder with a manifest; a folder with something else is not changed.

    The folder is made if it does not exist. If it has a manifest, which `read` reads, it must have
    the fields `ours`; `kind` is what messages call its content. What an interruption has left half
    written is deleted. A `RunFolderError` says what else the folder holds, that another process
    uses it, or that it cannot be read or written.
    """
    path = folder / manifest
    try:
        # What was killed before it wrote its manifest leaves only hidden files.
        is_foreign = (
            folder.exists()
            and not path.exists()
            and any(not each.name.startswith(".") for each in folder.iterdir())
        )
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be read: {error.strerror}") from error
    if is_foreign:
        raise RunFolderError(
            f"{folder} is not empty and holds no {kind}; choose another folder with --output"
        )
    with locked(folder):
        found = read() if path.exists() else ours
        found = found if isinstance(found, dict) else {}
        for field, was, now in differing_fields({name: found.get(name) for name in ours}, ours):
            raise RunFolderError(
                f"{folder} holds another {kind}: {field.removeprefix('suite.')} was {was}, now "
                f"{now}; choose another folder with --output, or delete this one"
            )
        places = [folder, *(each for each in folder.glob("*") if each.is_dir())]
        hidden = (each for place in places for each in place.glob(".*"))
        delete(each for each in hidden if re.fullmatch(PARTIAL, each.name))
        yield


def delete(paths: Iterable[Path]) -> None:
    """Deletes the files among some paths."""
    try:
        for path in paths:
            if path.is_file() and not path.is_symlink():
                path.unlink()
    except OSError as error:
        raise RunFolderError(f"{error.filename}: cannot be deleted: {error.strerror}") from error


@contextmanager
def opened_for_suite(
    folder: Path, manifest: str, kind: str, suite: Suite, others: Mapping[str, Any]
) -> Iterator[None]:
    """Opens a folder as `opened` does, and writes its manifest: some fields and the suite."""
    ours, path = {**others, "suite": suite.deciding()}, folder / manifest
    with opened(folder, manifest, kind, ours, partial(read_manifest, path)):
        write_bytes(path, (json.dumps(ours, indent=2, ensure_ascii=False) + "\n").encode())
        yield


def differing_fields(one: Any, other: Any, at: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yields where two JSON values differ: the path of the field, and both values."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in {**one, **other}:
            yield from differing_fields(one.get(key), other.get(key), f"{at}.{key}".lstrip("."))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for index, pair in enumerate(zip(one, other, strict=True)):
            yield from differing_fields(*pair, f"{at}[{index}]")
    elif one != other:
        yield at, one, other
