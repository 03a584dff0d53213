"""One process a run folder at a time."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from charms_bench.errors import RunFolderError

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps other processes out of a folder, which is made where there is none.

    The operating system holds the lock, so that it ends with its process, however that ends; the
    file stays.

    Raises:
        RunFolderError: Another process is in there, or the folder cannot be written to.
    """
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        raise RunFolderError(
            f"{folder}: another run is at work there; wait for it, or choose another folder with "
            "--output"
        ) from error
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be written: {error.strerror or error}") from error
    with lock:
        lock.release()  # of the two times it was acquired
        yield
