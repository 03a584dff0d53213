"""Files from outside: regular ones, of a size that is known to be read."""

import errno
import stat
from pathlib import Path


def size_of(path: Path) -> int:
    """The size of a regular file, bytes.

    Raises:
        OSError: There is none, or it is a folder, a pipe or a device, which may never end.
    """
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
    """The content of a regular file.

    Raises:
        OSError: It cannot be read, or holds more than `limit` bytes, whatever its announced size.
    """
    if size_of(path) <= limit:
        with path.open("rb") as file:
            data = file.read(limit + 1)
        if len(data) <= limit:
            return data
    raise OSError(errno.EFBIG, f"larger than {limit:,} bytes")
