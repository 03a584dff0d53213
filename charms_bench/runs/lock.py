"""Locks a run folder, so that only one process at a time uses it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from charms_bench.errors import RunFolderError

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps other processes out of a folder, which is made if it does not exist.

    The operating system releases the lock when the process ends, even if it is killed. The lock
    file stays. A `RunFolderError` says that another process uses the folder, that it cannot be
    written to, or that it holds links, behind which a file outside could be written or deleted.
    """
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _reject_links(*folder.glob("*"), *folder.glob("*/*"))
        lock.acquire()
    except Timeout as error:
        raise RunFolderError(
            f"{folder}: another run is using this folder; wait for it to end, or choose another "
            "folder with --output"
        ) from error
    except OSError as error:
        where = error.filename or folder
        raise RunFolderError(f"{where}: cannot be written: {error.strerror or error}") from error
    try:
        yield
    finally:
        lock.release()


def folder_in(run: Path, name: str) -> Path:
    """A folder of a run for what is written beside its rows.

    A `RunFolderError` says that it is a link, behind which a file outside could be written.
    """
    _reject_links(run / name)
    return run / name


def _reject_links(*paths: Path) -> None:
    if links := sorted(path for path in paths if path.is_symlink()):
        raise RunFolderError(
            f"{links[0]}: is a link; expected a file or a folder; copy what it leads to"
        )
