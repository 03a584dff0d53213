"""Reads regular files of limited size; writes files so that they appear complete or not at all."""

import errno
import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

from charms_bench.errors import InputError, RunFolderError


def absolute(path: str | Path) -> Path:
    """The path from the root, because a plugin can change the current folder.

    Raises an `InputError` if the path is relative and the current folder has been deleted.
    """
    try:
        return Path(path).absolute()
    except OSError as error:
        what = "the current folder has been deleted; change to another folder"
        raise InputError(f"{path}: {what}") from error


def is_same_file(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file that exists."""
    try:
        return one.samefile(other)
    except (OSError, ValueError):  # one does not exist, or no file can have its name
        return False


def check_ending(path: Path, *endings: str) -> None:
    """Raises an `InputError` for a file name with another ending than these, in small letters."""
    if path.suffix.lower() not in endings:
        raise InputError(f"{path}: expected a name that ends in {', '.join(endings)}")


MARK = "charms-bench"
"""What the files have in them that commands write where users say."""
_PAGE = '<meta name="generator" content="charms-bench'
_MARKS = {
    **dict.fromkeys((".html", ".htm"), _PAGE),
    ".xml": 'author="charms-bench"',
    ".onnx": "decision_hz",  # a key of the metadata
    ".parquet": "target_lane",  # a column of trajectories
}
"""What those have instead whose name ends so."""
PARTIAL = r"\..+\.[0-9]+\.partial"
"""The name of a file that is being written; see `write_atomically`."""


def size_of(path: Path) -> int:
    """The size of a regular file, bytes; raises an `OSError` for anything else."""
    try:
        found = path.stat()
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, "no file can have this name") from error
    if stat.S_ISDIR(found.st_mode):
        raise OSError(errno.EISDIR, "is a folder")
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "is a pipe or a device, not a file")
    return found.st_size


def read_limited(path: Path, limit: int) -> bytes:
    """The content of a regular file; raises an `OSError` if it has more than `limit` bytes."""
    if size_of(path) <= limit:
        with path.open("rb") as file:
            data = file.read(limit + 1)
        if len(data) <= limit:
            return data
    raise OSError(errno.EFBIG, f"larger than {limit:,} bytes")


def read_file(path: Path, limit: int) -> bytes:
    """As `read_limited`, of a file in a run folder; raises a `RunFolderError`."""
    try:
        return read_limited(path, limit)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror}") from error


_OUTPUT_LIMIT_BYTES = 2**30


def reject_foreign(path: Path) -> None:
    """Raises an `InputError` if something without the mark of what we write is at a path."""
    mark = _MARKS.get(path.suffix.lower(), MARK)
    try:
        if mark.encode() in read_limited(path, _OUTPUT_LIMIT_BYTES):
            return
    except FileNotFoundError:
        return
    except OSError:
        pass  # a folder, a pipe, or a file that we may not read
    raise InputError(
        f"{path}: already exists, and charms-bench has not written it; delete it, or choose "
        "another name"
    )


_CONTAINERS_LIMIT = 2**20
"""Lists and objects of a JSON text; an empty list takes twenty times its size in memory."""


def json_of(data: bytes, **options: Any) -> Any:
    """The value of a JSON text, which takes at most about ten times its size in memory.

    Raises a `ValueError` if it is not JSON, is nested too deep, gives a name twice, or has too many
    lists and objects.
    """
    if data.count(b"[") + data.count(b"{") > _CONTAINERS_LIMIT:
        raise ValueError(f"it has more than {_CONTAINERS_LIMIT:,} lists and objects")
    try:
        return json.loads(data, object_pairs_hook=given_once, **options)
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error


def given_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of a JSON text; raises a `ValueError` if it gives a name twice."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"'{name[:80]}' is given twice")
        found[name] = value
    return found


_COMPRESSED = (b"\x1f\x8b", b"x\x01", b"x^", b"x\x9c", b"x\xda", b"\x28\xb5\x2f\xfd")
"""How gzip, zlib and Zstandard begin; polars would decompress a table of these without a limit."""


def is_compressed(beginning: bytes) -> bool:
    """Whether a file that begins like this would be decompressed as a table."""
    return beginning.startswith(_COMPRESSED)


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Lets `write` fill a temporary file and moves it to `path`, or raises a `RunFolderError`."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)  # it may be a link
        try:
            write(partial)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be written: {error.strerror or error}") from error


def write_bytes(path: Path, data: bytes) -> None:
    """Writes a file atomically; see `write_atomically`."""
    write_atomically(path, lambda partial: partial.write_bytes(data))
