"""Checks that a run folder holds the files of its run, and names every other file."""

import hashlib
import os
import stat
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from charms_bench.errors import RunFolderError
from charms_bench.foundation.files import read_limited
from charms_bench.foundation.words import counted
from charms_bench.runs.audit_finding import Finding
from charms_bench.runs.audit_software import Planned
from charms_bench.runs.lock import LOCK
from charms_bench.runs.resumable_folder import (
    CHECKSUMS,
    FILE_LIMIT_BYTES,
    KINDS,
    MANIFEST,
    NETWORKS,
    ROADS,
    RunFolder,
)
from charms_bench.runs.shard_names import Shard, places_of, shard_named
from charms_bench.runs.shard_rows import problem_between
from charms_bench.runs.suite import Suite

UNCHECKED = ("figures", "replays", "datasets")
"""Folders that commands write for readers; their contents are not checked."""
TABLES = "tables"


def audit_networks(folder: RunFolder) -> Iterator[Finding]:
    """Yields whether the networks in the folder have the hashes in the manifest."""
    good, hashes = 0, folder.network_hashes()
    for name, sha256 in hashes.items():
        path = folder.path / NETWORKS / f"{sha256}.onnx"
        try:
            found = hashlib.sha256(read_limited(path, FILE_LIMIT_BYTES)).hexdigest()
            what = f"has the hash {found}, not the one in its name, which is {name}"
        except OSError as error:
            found, what = "", f"cannot be read, which is {name}: {error.strerror}"
        good += found == sha256
        if found != sha256:
            yield Finding("networks", f"{NETWORKS}/{path.name}", "fail", what)
    if good == len(hashes) > 0:
        yield Finding("networks", "", "pass", f"{good} of {good} have the hash in the manifest")


def audit_files(
    folder: RunFolder, suite: Suite, cells: Sequence[Planned], is_same: bool
) -> Iterator[Finding]:
    """Yields whether the folder holds the shards of its suite, intact, and nothing else.

    If the manifest names the same software as the installed one, shards must have its keys.
    """
    names = folder.finished()
    found = [*_shards(folder, suite, names, cells, is_same), *_unexpected(folder, names)]
    yield from found
    if all(each.verdict == "unknown" for each in found):
        what = f"the files of {counted(len(names), 'shard')} match their checksums and have their "
        what += "episodes"
        yield Finding("files", "", "pass", what)


def _shards(
    folder: RunFolder, suite: Suite, names: Collection[str], cells: Sequence[Planned], is_same: bool
) -> Iterator[Finding]:
    """Whether every shard of the suite is there once, with the right key and with its episodes."""
    places, drivers = places_of(suite), folder.drivers(suite)
    by_place: dict[tuple[int, int], str] = {}
    for name in sorted(names):
        where, shard = f"{CHECKSUMS}/{name}.sha256", shard_named(name, places)
        if shard is None:
            yield Finding("files", where, "fail", "is not of a shard of the suite")
            continue
        other = by_place.setdefault((shard.cell, shard.first_seed), name)
        if other != name:
            yield Finding("files", where, "fail", f"has the episodes of {other}")
        for path in folder.damaged_files(shard):
            where = path.relative_to(folder.path).as_posix()
            yield Finding("files", where, "fail", "is missing or does not match its checksum")
        yield from _rows(folder, shard, drivers[shard.cell // len(suite.surroundings)])
    for (index, first), episodes in places.items():
        if (index, first) not in by_place:
            last = first + episodes - 1
            what = f"the rows of {cells[index].cell.title}, episodes {first} to {last} are missing"
            yield Finding("files", f"{CHECKSUMS}/{index:03d}-{first:09d}-*.sha256", "fail", what)
    expected = {name: shard for cell in cells for name, (shard, _) in cell.tasks.items()}
    for name, shard in expected.items() if is_same else ():
        if (found := by_place.get((shard.cell, shard.first_seed), name)) != name:
            what = "has a key of other software, agents or settings than the manifest says"
            where = f"{CHECKSUMS}/{found}.sha256"
            yield Finding("files", where, "fail", f"{what}; expected {name}")


def _rows(folder: RunFolder, shard: Shard, ego: str) -> Iterator[Finding]:
    """What is visibly wrong with the rows of a shard."""
    rows = {}
    for kind in KINDS:
        where = f"{kind}/{shard.name}.parquet"
        try:
            rows[kind] = folder.read_unchecked(kind, shard)
        except RunFolderError as error:
            what = str(error).removeprefix(f"{folder.path / where}: ")
            yield Finding("files", where, "fail", what)
    if len(rows) == len(KINDS) and (what := problem_between(rows, ego)):
        yield Finding("files", f"{CHECKSUMS}/{shard.name}.sha256", "fail", what)


def _unexpected(folder: RunFolder, names: Collection[str]) -> Iterator[Finding]:
    """What is in the folder beside the files of the run, the tables and `UNCHECKED`.

    A file that no command reads is not false, but nobody has checked it.
    """
    expected = {MANIFEST, LOCK}
    expected |= {f"{NETWORKS}/{sha256}.onnx" for sha256 in folder.network_hashes().values()}
    expected |= {f"{ROADS}/{sha256}.map" for sha256 in folder.road_hashes()}
    for name in names:
        expected |= {f"{CHECKSUMS}/{name}.sha256", *(f"{kind}/{name}.parquet" for kind in KINDS)}
    for path, kind in entries(folder.path):
        where = path.relative_to(folder.path).as_posix()
        top = where.partition("/")[0]
        if not stat.S_ISREG(kind):
            what = "is a link" if stat.S_ISLNK(kind) else "is a pipe or a device"
            yield Finding("files", where, "fail", f"{what}, not a file")
        elif where in expected or top in UNCHECKED or (top == TABLES and where.count("/") == 1):
            continue
        elif top in KINDS:
            yield Finding("files", where, "fail", "is not of a finished shard")
        elif top in (CHECKSUMS, NETWORKS, ROADS, TABLES):
            yield Finding("files", where, "fail", "is not a file of this run")
        else:
            yield Finding("files", where, "unknown", "is not a file of a run, and is not checked")


def entries(folder: Path) -> Iterator[tuple[Path, int]]:
    """Yields what a folder and its subfolders hold, with its `st_mode`; links are not followed."""
    for path, folders, files in os.walk(folder):
        folders.sort()
        for name in sorted([*folders, *files]):
            kind = Path(path, name).lstat().st_mode
            if not stat.S_ISDIR(kind):
                yield Path(path, name), kind
