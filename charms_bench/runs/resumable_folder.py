"""A run folder: its manifest and its shards; every file is written whole or not at all.

A shard is finished once its checksums are in the folder. They are written last, to a file of their
own in the format of `sha256sum`. A shard that does not match its checksums is simulated again.
"""

import hashlib
import json
import os
import platform
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench import __version__
from charms_bench.errors import RunFolderError, problem_in
from charms_bench.foundation.files import read_file, read_limited, write_bytes
from charms_bench.foundation.words import counted
from charms_bench.plugins.registry import is_network
from charms_bench.recording.columns import SCHEMAS
from charms_bench.runs.code_hashes import commit, library_versions, module_blobs
from charms_bench.runs.manifest import check_fields, delete, opened, read_manifest
from charms_bench.runs.shard import ShardFiles
from charms_bench.runs.shard_names import Shard, places_of, shard_named
from charms_bench.runs.shard_rows import (
    check_seeds,
    check_values,
    problem_between,
    problem_of_egos,
    rows_in,
)
from charms_bench.runs.suite import UNDECIDING, Suite
from charms_bench.runs.suite_roads import RoadEntry

FORMAT = 4
"""Version of the format of run folders, as docs/run-folders.md describes it."""
MANIFEST = "manifest.json"
KINDS = tuple(SCHEMAS)
"""The kinds of rows of a shard; each has a folder of its own."""
FILE_LIMIT_BYTES = 2**30
CHECKSUMS = "checksums"
NETWORKS = "networks"
"""The folder of networks that the suite gives by path; each file is named by its hash."""
AGAIN = "; run the suite again"
"""What helps against a damaged file."""
ROADS = "roads"
"""That of the road files and maps of the suite."""


class RunFolder:
    """The files of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._opened: os.stat_result | None = None

    @contextmanager
    def opened_for(self, suite: Suite) -> Iterator[None]:
        """Locks the folder for running a suite; see `manifest.opened`."""
        with opened(self.path, MANIFEST, "run", {"suite": suite.deciding()}, self.manifest):
            self._opened = os.stat(self.path)
            yield

    def write_manifest(self, suite: Suite, agents: Mapping[str, Any]) -> None:
        """Writes the suite, the software and the machine of the run.

        `agents` are those of `shard.identify_agents`, of all cells.
        """
        manifest = self.manifest_of(suite, agents)
        text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
        write_bytes(self.path / MANIFEST, text.encode())

    @staticmethod
    def manifest_of(suite: Suite, agents: Mapping[str, Any]) -> dict[str, Any]:
        """Returns what `write_manifest` writes."""
        return {
            "format": FORMAT,
            "charms_bench": __version__,
            **suite.model_dump(mode="json", include=set(UNDECIDING)),
            "suite": suite.deciding(),
            "suite_sha256": suite.fingerprint(),
            "agents": agents,
            "metric_sets": {each.name: each.version for each in suite.metric_sets},
            "versions": library_versions(),
            "commit": commit(),
            "modules": module_blobs(),
            "machine": {
                "python": platform.python_version(),
                "system": platform.system(),
                "processor": platform.machine(),
                "cpus": os.cpu_count(),
            },
        }

    def manifest(self) -> dict[str, Any]:
        """Returns what `write_manifest` wrote.

        Raises a `RunFolderError` if that is missing, damaged or of another format.
        """
        path = self.path / MANIFEST
        if not self.path.is_dir():
            raise RunFolderError(f"{self.path}: no such folder")
        manifest = read_manifest(path)
        if not isinstance(manifest, dict):
            raise RunFolderError(f"{path}: expected a JSON object")
        if manifest.get("format") != FORMAT:
            has = f"has format {manifest['format']!r}" if "format" in manifest else "has no format"
            raise RunFolderError(
                f"{path}: {has}, expected format {FORMAT}; run the suite again into another "
                "folder, or read this one with the release of charms-bench that wrote it"
            )
        check_fields(path, manifest)
        return manifest

    def suite(self) -> Suite:
        """Returns the suite of the run, with the folder's copies of road files.

        Other relative paths have no folder to start from. Raises a `RunFolderError` if the manifest
        describes no suite.
        """
        suite = self.written_suite()
        return suite.model_copy(update={"roads": tuple(map(self._with_copy, suite.roads))})

    def written_suite(self) -> Suite:
        """Returns the suite as the manifest has it; see `suite`."""
        manifest = self.manifest()
        self._reject_roads_of_traffic(manifest)
        try:
            undeciding = {name: manifest[name] for name in UNDECIDING if name in manifest}
            return Suite.model_validate({**manifest["suite"], **undeciding})
        except (KeyError, TypeError, ValueError) as error:
            reason = problem_in(error)
            raise RunFolderError(f"{self.path / MANIFEST}: describes no suite: {reason}") from error

    def _with_copy(self, road: RoadEntry) -> RoadEntry:
        """The road, whose file is the copy in the folder."""
        copy = self._copy(ROADS, str(road.sha256))
        return road.model_copy(update={"file": copy}) if road.file and copy.exists() else road

    def _reject_roads_of_traffic(self, manifest: dict[str, Any]) -> None:
        """Raises a `RunFolderError` if roads were traffic models when the folder was written."""
        suite = manifest.get("suite")
        traffics = suite.get("traffics") if isinstance(suite, dict) else None
        entries = [each for each in traffics or () if isinstance(each, dict)]
        if any("road" in (each.get("traffic") or ()) for each in entries):
            raise RunFolderError(
                f"{self.path}: was written when roads were traffic models; `charms-bench run "
                f"{suite['suite']} --output {self.path}-2` makes it again"  # type: ignore[index]
            )

    def episodes(self) -> int:
        """Returns the number of episodes of the run; 0 without a manifest."""
        found = self.manifest().get("episodes", 0) if (self.path / MANIFEST).exists() else 0
        return found if isinstance(found, int) else 0

    def finished(self) -> list[str]:
        """Returns the names for which there are checksums."""
        return sorted(path.stem for path in (self.path / CHECKSUMS).glob("*.sha256"))

    def shards(self, suite: Suite) -> tuple[Shard, ...]:
        """Returns the finished shards, by cell and seed, with only the beginning of their keys.

        Raises:
            RunFolderError: A file is not of a shard of the suite, or two are of the same shard.
        """
        places, drivers = places_of(suite), self.drivers(suite)
        found: dict[tuple[int, int], Shard] = {}
        for name in self.finished():
            shard, path = shard_named(name, places), self._checksums(name)
            if shard is None:
                raise RunFolderError(
                    f"{path}: is not of a shard of the suite in {MANIFEST}; run the suite again, "
                    "or delete the file"
                )
            shard = replace(shard, ego=drivers[shard.cell // len(suite.surroundings)])
            other = found.setdefault((shard.cell, shard.first_seed), shard)
            if other != shard:
                raise RunFolderError(
                    f"{path}: has the episodes of {other.name}; run the suite again; if both "
                    "stay, delete the one that no run has written"
                )
        return tuple(found.values())

    def drivers(self, suite: Suite) -> list[str]:
        """What driver rows call each ego: a network is named by its hash."""
        hashes, egos = self.network_hashes(), [ego.agent for ego in suite.egos]
        return [f"{hashes.get(ego.name)}.onnx" if is_network(ego.name) else ego.key for ego in egos]

    def has(self, shard: Shard) -> bool:
        """Returns whether the shard was finished; its files may have changed since."""
        return self._checksums(shard.name).exists()

    def is_whole(self, shard: Shard) -> bool:
        """Returns whether the shard is finished, unchanged, and of its ego's episodes."""
        try:
            self._files(shard.name, shard)
        except RunFolderError:
            return False
        return True

    def write(self, shard: Shard, files: ShardFiles) -> None:
        """Writes a finished shard.

        Raises a `RunFolderError` if the folder has been replaced, or rows are of other episodes.
        """
        self._reject_replaced()
        for kind in KINDS:
            check_seeds(files[kind], shard, self._file(kind, shard.name))
        for kind in KINDS:
            write_bytes(self._file(kind, shard.name), files[kind])
        write_bytes(self._checksums(shard.name), _checksums(shard.name, files))

    def _reject_replaced(self) -> None:
        """Checks that this is still the folder that was opened, and that it has no links."""
        if self._opened and not os.path.samestat(self._opened, os.stat(self.path)):
            raise RunFolderError(f"{self.path}: was replaced during the run; run the suite again")
        for folder in (*KINDS, CHECKSUMS):
            if (self.path / folder).is_symlink():
                raise RunFolderError(f"{self.path / folder}: became a link during the run")

    def take(self, shards: Iterable[Shard], other: Path, notice: Callable[[str], None]) -> None:
        """Copies the shards that another run has finished; its cells may be in another order.

        `notice` is called with what is wrong with one that cannot be copied. A `RunFolderError` is
        raised if none can be.
        """
        has_some = False
        for shard in shards:
            seed_and_key = shard.name.partition("-")[2]
            for path in (other / CHECKSUMS).glob(f"*-{seed_and_key}.sha256"):
                try:
                    files = RunFolder(other)._files(path.stem, shard)
                except RunFolderError as error:
                    what = str(error).removesuffix(AGAIN)
                    notice(f"{what}; its {counted(shard.episodes, 'episode')} are not copied")
                    continue
                has_some = True
                if not self.is_whole(shard):
                    self.write(shard, files)
        if not has_some:
            raise RunFolderError(
                f"{other}: holds no rows of this suite that can be copied; expected a run of the "
                "same version, with the same scene, seeds and agents"
            )

    def read(self, kind: str, shards: Iterable[Shard]) -> pl.DataFrame:
        """Returns the rows of one of `KINDS`, of some shards; networks have the suite's names.

        Raises a `RunFolderError` if a file is missing or has changed, or has rows of others.
        """
        parts = {self._file(kind, shard.name): self._read(kind, shard) for shard in shards}
        rows = check_values(kind, parts)
        if "agent" not in rows.columns:
            return rows
        names = {f"{sha256}.onnx": name for name, sha256 in self.network_hashes().items()}
        return rows.with_columns(pl.col("agent").replace(names))

    def _read(self, kind: str, shard: Shard) -> pl.DataFrame:
        path, checksums = self._file(kind, shard.name), self._checksums(shard.name)
        data, lines = _content(path), _content(checksums).splitlines()
        if _checksum(kind, shard.name, data) not in lines:
            raise RunFolderError(f"{path}: does not match its checksum in {checksums}{AGAIN}")
        rows = rows_in(data, kind, shard, path)
        if kind == "drivers" and (problem := problem_of_egos(rows, shard.ego)):
            raise RunFolderError(f"{path}: {problem}; run the suite again")
        return rows

    def content(self, kind: str, shard: Shard) -> bytes:
        """Returns a file of a shard, whatever its checksum, or raises a `RunFolderError`."""
        return _content(self._file(kind, shard.name))

    def read_unchecked(self, kind: str, shard: Shard) -> pl.DataFrame:
        """Returns the rows in `content`, whose networks are named by their hashes.

        Raises a `RunFolderError` if they are not of this shard.
        """
        path = self._file(kind, shard.name)
        return check_values(kind, {path: rows_in(self.content(kind, shard), kind, shard, path)})

    def damaged_files(self, shard: Shard) -> list[Path]:
        """Returns the files of a shard that are missing or do not match their checksums."""
        checksums, found = self._checksums(shard.name), dict.fromkeys(KINDS, b"")
        try:
            written = _content(checksums).split(b"\n")
        except RunFolderError:
            return [checksums]
        for kind in KINDS:
            with suppress(RunFolderError):
                found[kind] = _checksum(kind, shard.name, self.content(kind, shard))
        damaged = [self._file(kind, shard.name) for kind in KINDS if found[kind] not in written]
        return damaged or [checksums] * (written != [*found.values(), b""])

    def reject_damaged(self, shards: Iterable[Shard]) -> None:
        """Raises a `RunFolderError` if a file of these shards is one of `damaged_files`."""
        for shard in shards:
            for path in self.damaged_files(shard):
                raise RunFolderError(f"{path}: is missing or does not match its checksum{AGAIN}")

    def _files(self, name: str, shard: Shard) -> ShardFiles:
        """Returns the files of this name.

        Raises a `RunFolderError` if they are not whole, or do not have the rows of the shard.
        """
        paths = {kind: self._file(kind, name) for kind in KINDS}
        files = {kind: _content(path) for kind, path in paths.items()}
        checksums, written = self._checksums(name), _checksums(name, files).split(b"\n")
        found = _content(checksums).split(b"\n")
        for path, line in zip(paths.values(), written, strict=False):
            if line not in found:
                raise RunFolderError(f"{path}: does not match its checksum in {checksums}{AGAIN}")
        if found != written:
            raise RunFolderError(f"{checksums}: has other lines than those of its files{AGAIN}")
        rows = {
            kind: check_values(kind, {path: rows_in(files[kind], kind, shard, path)})
            for kind, path in paths.items()
        }
        if what := problem_between(rows, shard.ego):
            raise RunFolderError(f"{checksums}: {what}{AGAIN}")
        return files

    def keep(self, kind: str, file: Path, sha256: str) -> None:
        """Copies a file that the suite names, so that the folder is complete.

        `kind` is `NETWORKS` or `ROADS`. Raises a `RunFolderError` if the file no longer has this
        hash.
        """
        data, copy = read_file(file, FILE_LIMIT_BYTES), self._copy(kind, sha256)
        if hashlib.sha256(data).hexdigest() != sha256:
            raise RunFolderError(f"{file}: has changed since the run began; run the suite again")
        with suppress(OSError):
            if read_limited(copy, FILE_LIMIT_BYTES) == data:
                return
        write_bytes(copy, data)

    def road_hashes(self) -> set[str]:
        """Returns the SHA-256 of the files of all roads."""
        suite = self.manifest().get("suite")
        roads = suite.get("roads") if isinstance(suite, dict) else None
        found = (str(road.get("sha256")) for road in roads or () if isinstance(road, dict))
        return {each for each in found if re.fullmatch("[0-9a-f]{64}", each)}

    def network_hashes(self) -> dict[str, str]:
        """Returns the SHA-256 of each network that the suite gives by path, by its name there."""
        found = {
            name: identity.get("weights_sha256", "")
            for name, identity in self.manifest().get("agents", {}).items()
            if is_network(name)
        }
        return {name: each for name, each in found.items() if re.fullmatch("[0-9a-f]{64}", each)}

    def network(self, name: str) -> Path | None:
        """Returns the copy of a network that the suite gives by path, or None if it has none.

        Raises a `RunFolderError` if the copy has changed since it was written.
        """
        sha256 = self.network_hashes().get(name, "")
        copy = self._copy(NETWORKS, sha256)
        if not copy.exists():
            return None
        if hashlib.sha256(read_file(copy, FILE_LIMIT_BYTES)).hexdigest() != sha256:
            raise RunFolderError(f"{copy}: has changed since it was written; run the suite again")
        return copy

    def reject_to_drop(self, suite: Suite, shards: Iterable[Shard]) -> None:
        """Raises a `RunFolderError` if a shorter run would delete finished episodes."""
        episodes, names = self.episodes(), {shard.name for shard in shards}
        lost = [name for name in self.finished() if name not in names]
        if episodes > suite.episodes and lost:
            raise RunFolderError(
                f"{self.path}: has {counted(len(lost), 'finished shard')} of a run of "
                f"{counted(episodes, 'episode')}, which a run of {suite.episodes:,} would delete; "
                f"choose another folder with --output, run with --episodes {episodes}, or delete "
                "them with --shorten (in Python: output, episodes or shorten)"
            )

    def drop_others(self, shards: Iterable[Shard]) -> None:
        """Deletes every shard that is not one of these, and every network and road of another run.

        Users' files can have such names, too. Those that a run has written also have the hash in
        their checksums or in their name.
        """
        kept, hashes, checksums = {shard.name for shard in shards}, dict[Path, str](), []
        for name in self.finished():
            if name not in kept and (written := self._hashes(name)):
                hashes |= written
                checksums.append(self._checksums(name))
        others = {*self.network_hashes().values(), *self.road_hashes()}
        for kind in (NETWORKS, ROADS):
            for path in (self.path / kind).glob("*"):
                if path.stem not in others and path == self._copy(kind, path.stem):
                    hashes[path] = path.stem
        delete(path for path, sha256 in hashes.items() if _sha256(path) == sha256)
        delete(checksums)

    def _hashes(self, name: str) -> dict[Path, str]:
        """The hashes of files in the checksums of this name; empty if no run has written these."""
        with suppress(RunFolderError):
            text = _content(self._checksums(name)).decode(errors="replace")
            lines = [line.split("  ", 1) for line in text.splitlines()]
            if [line[1:] for line in lines] == [[f"{kind}/{name}.parquet"] for kind in KINDS]:
                return {self.path / file: sha256 for sha256, file in lines}
        return {}

    def _copy(self, kind: str, sha256: str) -> Path:
        return self.path / kind / f"{sha256}.{'onnx' if kind == NETWORKS else 'map'}"

    def _file(self, kind: str, name: str) -> Path:
        return self.path / kind / f"{name}.parquet"

    def _checksums(self, name: str) -> Path:
        return self.path / CHECKSUMS / f"{name}.sha256"


def _content(path: Path) -> bytes:
    try:
        return read_limited(path, FILE_LIMIT_BYTES)
    except OSError as error:
        raise RunFolderError(
            f"{error.filename or path}: cannot be read: {error.strerror}; run the suite again"
        ) from error


def _sha256(path: Path) -> str:
    """The SHA-256 of a file; empty if it cannot be read."""
    with suppress(OSError):
        return hashlib.sha256(read_limited(path, FILE_LIMIT_BYTES)).hexdigest()
    return ""


def _checksums(name: str, files: ShardFiles) -> bytes:
    """Returns what `sha256sum` prints for a shard's files when it runs in the run folder."""
    return b"".join(_checksum(kind, name, files[kind]) + b"\n" for kind in KINDS)


def _checksum(kind: str, name: str, data: bytes) -> bytes:
    return f"{hashlib.sha256(data).hexdigest()}  {kind}/{name}.parquet".encode()
