"""Standard input, output and error, each of which may be closed, full or a pipe without a reader.

What cannot be written to standard error is dropped, because no place is left to report it. Results
that cannot be written to standard output are an error.
"""

import io
import os
import sys
from contextvars import ContextVar
from typing import Any, TextIO

from charms_bench.errors import InputError

QUIET: ContextVar[bool] = ContextVar("QUIET", default=False)
"""Whether progress, and messages beside the results, are left out."""


def open_closed_streams() -> None:
    """Connects each of the three descriptors that is closed to the null device.

    Otherwise the next file that is opened would get its number, and messages would be written to
    that file.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            found = os.open(os.devnull, os.O_RDWR)  # the lowest free number
            if found != descriptor:
                os.dup2(found, descriptor)
                os.close(found)
            os.set_inheritable(descriptor, True)


def write_reliably() -> None:
    """Prepares the standard streams of a command, whatever they are connected to."""
    open_closed_streams()
    if sys.stdout is sys.__stdout__:
        sys.stdout = _text(_Reporting(1, "w", closefd=False), sys.stdout)
    if sys.stderr is sys.__stderr__:
        sys.stderr = _text(_Dropping(2, "w", closefd=False), sys.stderr)


def write_to_stderr_only() -> None:
    """Has everything that this process prints go to standard error."""
    open_closed_streams()
    os.dup2(2, 1)
    sys.stdout = sys.stderr = _text(_Dropping(2, "w", closefd=False), sys.stderr)


class _Dropping(io.FileIO):
    """Drops what cannot be written."""

    def write(self, data: Any) -> int | None:  # type: ignore[override]
        try:
            return super().write(data)
        except OSError:
            return len(data)


class _Reporting(io.FileIO):
    """Reports once that something cannot be written; a reader that has left is not an error."""

    def write(self, data: Any) -> int | None:  # type: ignore[override]
        try:
            return super().write(data)
        except BrokenPipeError:
            raise
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            raise InputError(f"standard output: cannot be written: {error.strerror}") from error


def _text(raw: io.FileIO, like: TextIO | None) -> io.TextIOWrapper:
    """A text stream with the encoding of another one; a log in ASCII gets question marks."""
    encoding = getattr(like, "encoding", None) or "utf-8"
    file = io.BufferedWriter(raw)
    lines = raw.isatty() or raw.fileno() == 2
    return io.TextIOWrapper(file, encoding=encoding, errors="replace", line_buffering=lines)
