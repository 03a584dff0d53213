"""Recordings for `data` whose tables are damaged, or announce more than they hold."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from bad_input import BadInput
from trios import Row, driven, write_trio

HEADER = b"frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,laneId"
BLOCK = b"\x00\x00\x00\xff\xff"
"""An empty block of a deflated stream."""
COMPRESSED = {
    # The name of the packed file in gzip's head, up to a NUL, holds what looks like a first line.
    "gzip": b"\x1f\x8b\x08\x08" + bytes(6) + b"," + HEADER + b",\n\x00" + BLOCK * 10,
    "zlib": b"\x78\x5e," + HEADER + b",\n" + BLOCK * 10,
}


def _recording(folder: Path) -> None:
    write_trio(folder, driven(Row(), 3))


def _edit(name: str, old: str, new: str) -> Callable[[Path], object]:
    """Replaces a text in one file of a recording."""

    def make(folder: Path) -> None:
        _recording(folder)
        path = folder / f"01_{name}.csv"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return make


def _replaced(name: str, content: bytes) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        _recording(folder)
        (folder / f"01_{name}.csv").write_bytes(content)

    return make


def _no_rows(folder: Path) -> None:
    """Announces no number of vehicles, and has no row of any."""
    (folder / "01_recordingMeta.csv").write_text(
        "frameRate,upperLaneMarkings,lowerLaneMarkings\n25,10;14;18,30;34\n"
    )
    (folder / "01_tracksMeta.csv").write_text("id,class\n1,Car\n")
    (folder / "01_tracks.csv").write_text("frame,id,x,y,width,height\n")


def _special(name: str, make_file: Callable[[Path], object]) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        _recording(folder)
        path = folder / f"01_{name}.csv"
        path.unlink()
        make_file(path)

    return make


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


FIRST = "1,1,100.0,"
FORMULAS = ("=1+1", "1e400", "1_0", "१")
FOLDERS: dict[str, Callable[[Path], object]] = {
    **{f"a cell {cell!r}": _edit("tracks", FIRST, f"{cell},1,100.0,") for cell in FORMULAS},
    "10^9 rows announced": _edit("tracksMeta", "1,1,3,3,", "1,1,1000000000,1000000000,"),
    "a frame rate of 10^300": _edit("recordingMeta", "25,1,", "1e300,1,"),
    "3,000,000 markings": _replaced(
        "recordingMeta",
        b"id,frameRate,numVehicles,upperLaneMarkings,lowerLaneMarkings\n1,25,1,"
        + b"1;" * 3_000_000
        + b",30;34\n",
    ),
    "nothing": _replaced("tracks", b""),
    "only names, of no announced vehicles": _no_rows,
    "a header of 2 MB": _replaced("tracks", b"frame,id," + b"x," * 2**20 + b"\n"),
    "a line of 2 MB": _replaced("tracks", b"frame,id,x,y,width,height,xVelocity,yVelocity,"
                                b"xAcceleration,yAcceleration,laneId\n" + b"," * 2**21 + b"\n"),
    "2,000,000 empty lines": _replaced("tracks", b"frame,id,x,y,width,height,xVelocity,yVelocity,"
                                       b"xAcceleration,yAcceleration,laneId\n" + b"\n" * 2**21),
    "a quote that is never closed": _edit("tracks", FIRST, '1,1,"100.0,'),
    "UTF-16": _replaced("tracks", "frame,id".encode("utf-16")),
    "a picture": _replaced("tracksMeta", b"\x89PNG\r\n\x1a\n" + bytes(1000)),
    **{
        f"a first line in the head of {name}": _replaced("tracks", content)
        for name, content in COMPRESSED.items()
    },
    "a pipe": _special("tracks", os.mkfifo),
    "a folder": _special("tracks", Path.mkdir),
    "a link to /dev/zero": _special("tracks", lambda path: path.symlink_to("/dev/zero")),
    "a link to nowhere": _special("recordingMeta", lambda path: path.symlink_to("nowhere")),
    "a terabyte": _special("tracks", _sparse),
}  # fmt: skip


def _bad(title: str, make_files: Callable[[Path], object]) -> BadInput:
    def make(folder: Path) -> Sequence[object]:
        (folder / "recordings").mkdir()
        make_files(folder / "recordings")
        return "data", "recordings"

    return BadInput(f"recordings: {title}", make)


CASES = tuple(_bad(*item) for item in FOLDERS.items())
