"""The recordings of a folder, in highD's format or as tables of NGSIM."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from charms_bench.errors import DataError
from charms_bench.world.highd import KINDS, read_highd
from charms_bench.world.ngsim import is_ngsim, read_ngsim
from charms_bench.world.trajectories import Recording, Trio


def find_trios(folder: Path) -> list[Trio]:
    """The recordings of a folder, sorted by number, or that of one table of NGSIM.

    Raises:
        DataError: The folder has no recordings, or a recording lacks a file.
    """
    if folder.is_file():
        return _in_tables([folder], folder)
    found: dict[str, dict[str, Path]] = {}
    others: list[Path] = []
    try:
        for path in sorted(folder.iterdir()):
            if match := re.fullmatch(rf"([0-9]{{1,9}})_({'|'.join(KINDS)})\.csv", path.name):
                found.setdefault(match[1], {})[match[2]] = path
            elif path.suffix in (".csv", ".xml"):
                others.append(path)
    except OSError as error:
        raise DataError(
            f"{folder}: cannot be read: {error.strerror}; recordings are not part of charms-bench, "
            "so give the folder of your own ones, in highD's format"
        ) from error
    if not found:
        return _in_tables(others, folder)
    trios: dict[int, Trio] = {}
    for prefix, files in found.items():
        for kind in KINDS:
            if kind not in files:
                raise DataError(
                    f"{folder}: recording {prefix} has no {prefix}_{kind}.csv; "
                    "add it, or remove the recording's other files"
                )
        number = int(prefix)
        if number in trios:
            raise DataError(f"{folder}: recording {number} appears twice; rename one of them")
        trios[number] = Trio(number, *(files[kind] for kind in KINDS))
    return [trios[number] for number in sorted(trios)]


def _in_tables(paths: Sequence[Path], place: Path) -> list[Trio]:
    """The tables of NGSIM among some files; raises a `DataError` without one."""
    found = [path for path in paths if path.suffix == ".csv" and is_ngsim(path)]
    if not found and any(path.suffix == ".xml" for path in paths):
        raise DataError(
            f"{place}: CommonRoad scenarios are not read as recordings; give each as one of the "
            "suite's `roads`, {file: ..., configuration: {start: recorded}}"
        )
    if not found:
        raise DataError(
            f"{place}: no recordings; expected files named like 01_tracks.csv, or a CSV table of "
            "NGSIM with the columns Vehicle_ID, Frame_ID, Local_X and Local_Y"
        )
    return [Trio(number, path, path, path) for number, path in enumerate(found, start=1)]


def read_folder(folder: Path) -> Iterator[Recording]:
    """The recordings of a folder, one at a time."""
    return map(read_recording, find_trios(folder))


def read_recording(trio: Trio) -> Recording:
    """A recording in the simulation's frame of reference.

    Raises:
        DataError: A file cannot be read, or the three files contradict each other.
    """
    return read_ngsim(trio) if trio.tracks == trio.recording_meta else read_highd(trio)
