"""A run folder: its manifest and its shards; every file is written whole or not at all.

A shard is finished once its checksums are in the folder. They are written last, to a file of their
own in the format of `sha256sum`. A shard that does not match its checksums is simulated again.
"""

import hashlib
import json
import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench import __version__
from charms_bench.engine.columns import SCHEMAS
from charms_bench.errors import RunFolderError
from charms_bench.metrics import METRIC_SETS
from charms_bench.plugins.registry import is_network
from charms_bench.runs.code_hashes import commit, library_versions, module_blobs
from charms_bench.runs.lock import locked
from charms_bench.runs.manifest import read_manifest, refuse_another, refuse_foreign
from charms_bench.runs.shard import ShardFiles
from charms_bench.runs.suite import PRESENTATION, Suite
from charms_bench.world.files import read_file, read_limited, write_bytes
from charms_bench.world.scene import DECISIONS_LIMIT

FORMAT = 3
"""Version of the format of run folders, as docs/run-folders.md describes it."""
MANIFEST = "manifest.json"
KINDS = tuple(SCHEMAS)
"""The kinds of rows of a shard; each has a folder of its own."""
FILE_LIMIT_BYTES = 2**30
ROWS_LIMIT = 150 * DECISIONS_LIMIT
"""Most rows of a shard; a Parquet file of a few bytes can repeat a row without end."""
CHECKSUMS = "checksums"
NETWORKS = "networks"
"""The folder of networks that the suite gives by path; each file is named by its hash."""
_UNDECIDING = ("episodes", *PRESENTATION)
"""Fields of a suite that decide no row."""


@dataclass(frozen=True)
class Shard:
    """A fixed number of episodes of a cell."""

    cell: int
    """Index into `Suite.cells`."""
    first_seed: int
    episodes: int
    key: str
    """Hash of everything that its rows depend on."""

    @property
    def name(self) -> str:
        """Name of its files, without the ending."""
        return f"{self.cell:03d}-{self.first_seed:09d}-{self.key[:16]}"


class RunFolder:
    """The files of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def opened_for(self, suite: Suite, engine: str) -> Iterator[None]:
        """Locks the folder for running a suite; a folder with another run is not changed.

        Raises:
            RunFolderError: The folder holds something else, another process uses it, or it
                cannot be read or written.
        """
        refuse_foreign(self.path, MANIFEST, "run")
        with locked(self.path):
            if (self.path / MANIFEST).exists():
                fields = json.loads(suite.model_dump_json(exclude=set(_UNDECIDING)))
                ours = {"suite": fields, "engine": engine}
                manifest = self.manifest()
                refuse_another(self.path, "run", {key: manifest.get(key) for key in ours}, ours)
            for folder in ("", *KINDS, CHECKSUMS, NETWORKS, "tables", "figures"):
                for partial in (self.path / folder).glob(".*.partial"):
                    partial.unlink()
            yield

    def write_manifest(self, suite: Suite, engine: str, agents: Mapping[str, Any]) -> None:
        """Writes the suite, the software and the machine of the run.

        Args:
            suite: What is run.
            engine: The engine's name.
            agents: See `shard.identify_agents`; of all cells.
        """
        manifest = {
            "format": FORMAT,
            "charms_bench": __version__,
            **json.loads(suite.model_dump_json(include=set(_UNDECIDING))),
            "suite": json.loads(suite.model_dump_json(exclude=set(_UNDECIDING))),
            "suite_sha256": suite.fingerprint(),
            "engine": engine,
            "agents": agents,
            "metric_sets": {each.name: each.version for each in METRIC_SETS},
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
        text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
        write_bytes(self.path / MANIFEST, text.encode())

    def manifest(self) -> dict[str, Any]:
        """Returns what `write_manifest` wrote.

        Raises:
            RunFolderError: The manifest is missing, damaged or of another format.
        """
        path = self.path / MANIFEST
        manifest = read_manifest(path, FILE_LIMIT_BYTES)
        if not isinstance(manifest, dict):
            raise RunFolderError(f"{path}: expected a JSON object")
        if manifest.get("format") != FORMAT:
            has = f"has format {manifest['format']!r}" if "format" in manifest else "has no format"
            raise RunFolderError(
                f"{path}: {has}, expected format {FORMAT}; run the suite again into another "
                "folder, or read this one with the release of charms-bench that wrote it"
            )
        return manifest

    def suite(self) -> Suite:
        """Returns the suite of the run; its relative paths have no folder to start from.

        Raises:
            RunFolderError: The manifest cannot be read, or describes no suite.
        """
        manifest = self.manifest()
        try:
            undeciding = {name: manifest[name] for name in _UNDECIDING if name in manifest}
            return Suite.model_validate({**manifest["suite"], **undeciding})
        except (KeyError, TypeError, ValueError) as error:
            reason = str(error).replace("\n", " ")
            raise RunFolderError(f"{self.path / MANIFEST}: describes no suite: {reason}") from error

    def shards(self) -> tuple[Shard, ...]:
        """Returns the finished shards, by cell and seed, with only the beginning of their keys.

        Raises:
            RunFolderError: A file is not named like those of shards, or is damaged.
        """
        found = []
        for path in sorted((self.path / CHECKSUMS).glob("*.sha256")):
            match = re.fullmatch(r"(\d{3,})-(\d{9,})-([0-9a-f]{16})", path.stem)
            if match is None:
                raise RunFolderError(f"{path}: is not a shard of a run; delete the file")
            cell, first_seed, key = match.groups()
            rows = self._read("episodes", path.stem)
            found.append(Shard(int(cell), int(first_seed), len(rows), key))
        return tuple(found)

    def has(self, shard: Shard) -> bool:
        """Returns whether the shard was finished; its files may have changed since."""
        return self._checksums(shard.name).exists()

    def is_whole(self, shard: Shard) -> bool:
        """Returns whether the shard was finished and no byte of it has changed since."""
        return self._files(shard.name, shard) is not None

    def write(self, shard: Shard, files: ShardFiles) -> None:
        """Writes a finished shard.

        Raises:
            RunFolderError: The folder cannot be written to, or the rows are those of other
                episodes.
        """
        for kind in KINDS:
            path = self._file(kind, shard.name)
            _check_seeds(path, _seeds(path, files[kind]), shard)
        for kind in KINDS:
            write_bytes(self._file(kind, shard.name), files[kind])
        write_bytes(self._checksums(shard.name), _checksums(shard.name, files))

    def take(self, shards: Iterable[Shard], other: Path) -> None:
        """Copies the shards that another run has finished; its cells may be in another order.

        Raises:
            RunFolderError: The other run has none of the shards.
        """
        has_some = False
        for shard in shards:
            seed_and_key = shard.name.partition("-")[2]
            for path in (other / CHECKSUMS).glob(f"*-{seed_and_key}.sha256"):
                files = RunFolder(other)._files(path.stem, shard)
                has_some = has_some or files is not None
                if files is not None and not self.is_whole(shard):
                    self.write(shard, files)
        if not has_some:
            raise RunFolderError(
                f"{other}: holds no rows of this suite; expected a run of the same version, with "
                "the same engine, scene, seeds and agents"
            )

    def read(self, kind: str, shards: Iterable[Shard]) -> pl.DataFrame:
        """Returns the rows of one of `KINDS`, of some shards; networks have the suite's names.

        Raises:
            RunFolderError: A file is missing or has changed since it was written.
        """
        rows = pl.concat([self._read_of(kind, shard) for shard in shards])
        if "agent" not in rows.columns:
            return rows
        names = {f"{sha256}.onnx": name for name, sha256 in self.network_hashes().items()}
        return rows.with_columns(pl.col("agent").replace(names))

    def _read_of(self, kind: str, shard: Shard) -> pl.DataFrame:
        rows = self._read(kind, shard.name)
        _check_seeds(self._file(kind, shard.name), rows["episode"], shard)
        return rows

    def _read(self, kind: str, name: str) -> pl.DataFrame:
        path, checksums = self._file(kind, name), self._checksums(name)
        data, lines = _content(path), _content(checksums).splitlines()
        if _checksum(kind, name, data) not in lines:
            raise RunFolderError(
                f"{path}: does not match its checksum in {checksums}; run the suite again"
            )
        return _rows(kind, path, data)

    def read_unchecked(self, kind: str, shard: Shard) -> pl.DataFrame:
        """Returns the rows of a shard, whose networks are named by their hashes.

        Raises:
            RunFolderError: The file cannot be read, or holds something else than such rows.
        """
        path = self._file(kind, shard.name)
        return _rows(kind, path, _content(path))

    def damaged_files(self, name: str) -> list[Path]:
        """Returns the files of a shard that are missing or do not match their checksums."""
        lines = _content(self._checksums(name)).splitlines()
        found = []
        for kind in KINDS:
            try:
                is_whole = _checksum(kind, name, _content(self._file(kind, name))) in lines
            except RunFolderError:
                is_whole = False
            if not is_whole:
                found.append(self._file(kind, name))
        return found

    def _files(self, name: str, shard: Shard) -> ShardFiles | None:
        """Returns the files of that name, or None if they are not those that the shard wrote."""
        try:
            files = {kind: read_limited(self._file(kind, name), FILE_LIMIT_BYTES) for kind in KINDS}
            written = read_limited(self._checksums(name), FILE_LIMIT_BYTES)
        except OSError:
            return None
        if written != _checksums(name, files):
            return None
        path = self._file("episodes", name)
        try:
            _check_seeds(path, _seeds(path, files["episodes"]), shard)
        except RunFolderError:
            return None
        return files

    def keep_network(self, network: Path, sha256: str) -> None:
        """Copies a network that the suite gives by path, so that the folder is complete.

        Raises:
            RunFolderError: The network no longer has this hash, or the folder cannot be written.
        """
        copy = self._network(sha256)
        data = network.read_bytes()
        if hashlib.sha256(data).hexdigest() != sha256:
            raise RunFolderError(f"{network}: has changed since the run began; run the suite again")
        if not copy.exists() or copy.read_bytes() != data:
            write_bytes(copy, data)

    def network_hashes(self) -> dict[str, str]:
        """Returns the SHA-256 of each network that the suite gives by path, by its name there."""
        agents = self.manifest().get("agents")
        found = {
            name: str(identity.get("weights_sha256"))
            for name, identity in (agents.items() if isinstance(agents, dict) else ())
            if is_network(name) and isinstance(identity, dict)
        }
        return {name: each for name, each in found.items() if re.fullmatch("[0-9a-f]{64}", each)}

    def network(self, name: str) -> Path | None:
        """Returns the copy of a network that the suite gives by path, or None if it has none.

        Raises:
            RunFolderError: The copy has changed since it was written, or cannot be read.
        """
        sha256 = self.network_hashes().get(name, "")
        copy = self._network(sha256)
        if not copy.exists():
            return None
        if hashlib.sha256(read_file(copy, FILE_LIMIT_BYTES)).hexdigest() != sha256:
            raise RunFolderError(f"{copy}: has changed since it was written; run the suite again")
        return copy

    def drop_others(self, shards: Iterable[Shard]) -> None:
        """Deletes every shard that is not one of these."""
        names = {shard.name for shard in shards}
        for folder in (CHECKSUMS, *KINDS):
            for path in sorted((self.path / folder).glob("*.*")):
                if path.stem not in names:
                    path.unlink()

    def _network(self, sha256: str) -> Path:
        return self.path / NETWORKS / f"{sha256}.onnx"

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


def _rows(kind: str, path: Path, data: bytes) -> pl.DataFrame:
    """Returns the rows in a Parquet file."""
    schema = SCHEMAS[kind]
    try:
        rows = pl.scan_parquet(BytesIO(data))
        found = rows.collect_schema()
        wrong = [name for name in schema if found.get(name) != schema[name]]
        if not wrong:
            # Later versions may add columns.
            read = rows.select(schema.names()).head(ROWS_LIMIT + 1).collect()
            if len(read) <= ROWS_LIMIT:
                return read
    except pl.exceptions.PolarsError as error:
        raise RunFolderError(f"{path}: is not a Parquet file; run the suite again") from error
    problem = (
        f"the columns {', '.join(wrong)} are missing or have other types"
        if wrong
        else f"holds more than {ROWS_LIMIT:,} rows"
    )
    raise RunFolderError(f"{path}: {problem}; run the suite again")


def _seeds(path: Path, data: bytes) -> pl.Series:
    """Returns the seed of the episode of each row in a Parquet file."""
    try:
        return pl.read_parquet(BytesIO(data), columns=["episode"])["episode"]
    except pl.exceptions.PolarsError as error:
        raise RunFolderError(f"{path}: has no episodes; run the suite again") from error


def _check_seeds(path: Path, seeds: pl.Series, shard: Shard) -> None:
    """Checks that the rows with these seeds belong to the episodes of a shard.

    Raises:
        RunFolderError: They belong to other episodes, or an episode has several rows in
            `episodes` or none.
    """
    last = shard.first_seed + shard.episodes - 1
    is_whole = path.parent.name != "episodes" or len(seeds) == shard.episodes == seeds.n_unique()
    if not is_whole or not seeds.is_between(shard.first_seed, last).all():
        found = f"{len(seeds):,} rows of episodes {seeds.min()!r} to {seeds.max()!r}"
        raise RunFolderError(
            f"{path}: holds {found}; expected those of episodes {shard.first_seed} to {last}; run "
            "the suite again"
        )


def _checksums(name: str, files: ShardFiles) -> bytes:
    """Returns what `sha256sum` prints for a shard's files when it runs in the run folder."""
    return b"".join(_checksum(kind, name, files[kind]) + b"\n" for kind in KINDS)


def _checksum(kind: str, name: str, data: bytes) -> bytes:
    return f"{hashlib.sha256(data).hexdigest()}  {kind}/{name}.parquet".encode()
