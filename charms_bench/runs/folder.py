"""A run folder: its manifest and its shards, each written whole or not at all.

A shard is finished once its checksums are there, which are written last, as a file of its own in
the format of `sha256sum`; what does not match them is simulated again.
"""

import hashlib
import json
import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench import __version__
from charms_bench.engine.following import COUNT_SCHEMA
from charms_bench.engine.recording import EPISODE_SCHEMA, STEP_SCHEMA
from charms_bench.errors import RunFolderError
from charms_bench.metrics import METRIC_SETS
from charms_bench.runs.lock import locked
from charms_bench.runs.suite import PRESENTATION, Suite
from charms_bench.world.files import read_limited, write_bytes
from charms_bench.world.scene import DECISIONS_LIMIT

MANIFEST = "manifest.json"
SCHEMAS = {"steps": STEP_SCHEMA, "counts": COUNT_SCHEMA, "episodes": EPISODE_SCHEMA}
KINDS = tuple(SCHEMAS)
"""The kinds of rows of a shard, as `Recording` has them, each in a folder of its own."""
FILE_LIMIT_BYTES = 2**30
ROWS_LIMIT = 150 * DECISIONS_LIMIT
"""Of a shard, which can say in a few bytes that it repeats one without end."""
CHECKSUMS = "checksums"
"""The folder of their checksums."""
NETWORKS = "networks"
"""The folder of the networks that a suite gives by path, each named by its hash."""
_UNDECIDING = ("episodes", *PRESENTATION)
"""Fields of a suite that decide no row."""
_RECORDED_VERSIONS = ("highway-env", "numba", "numpy", "onnxruntime", "polars")


@cache
def recorded_versions() -> dict[str, str]:
    """The libraries that may decide what a row holds, or how it is written."""
    return {name: version(name) for name in _RECORDED_VERSIONS}


ShardFiles = Mapping[str, bytes]
"""The Parquet files of a shard, by kind: one a kind of `KINDS`."""


def in_parquet(rows: pl.DataFrame) -> bytes:
    """Rows as a Parquet file."""
    file = BytesIO()
    rows.write_parquet(file)
    return file.getvalue()


@dataclass(frozen=True)
class Shard:
    """A fixed number of episodes of a cell; its key names everything its rows depend on."""

    cell: int
    """Index into `Suite.cells`."""
    first_seed: int
    episodes: int
    key: str

    @property
    def name(self) -> str:
        """Name of its files, without ending."""
        return f"{self.cell:03d}-{self.first_seed:09d}-{self.key[:16]}"


class RunFolder:
    """The files of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def opened_for(self, suite: Suite, engine: str) -> Iterator[None]:
        """Makes the folder this suite's, and this process's alone; another run is left as it is.

        Raises:
            RunFolderError: It holds another run, or one that is at work, or cannot be read or
                written.
        """
        if self._holds_something_else():
            raise RunFolderError(
                f"{self.path} is not empty and holds no run; choose another with --output"
            )
        with locked(self.path):
            if (self.path / MANIFEST).exists():
                self._refuse_another(suite, engine)
            for folder in ("", *KINDS, CHECKSUMS, NETWORKS, "tables", "figures"):
                for left in (self.path / folder).glob(".*.partial"):
                    left.unlink()
            yield

    def _holds_something_else(self) -> bool:
        """A run that was killed before it wrote its manifest has left hidden files alone."""
        try:
            return (
                self.path.exists()
                and not (self.path / MANIFEST).exists()
                and any(not path.name.startswith(".") for path in self.path.iterdir())
            )
        except OSError as error:
            raise RunFolderError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _refuse_another(self, suite: Suite, engine: str) -> None:
        fields = json.loads(suite.model_dump_json(exclude=set(_UNDECIDING)))
        ours = {"suite": fields, "engine": engine}
        theirs = self.manifest()
        for difference in _differences({key: theirs.get(key) for key in ours}, ours):
            raise RunFolderError(
                f"{self.path} holds another run: {difference}; "
                "choose another folder with --output, or delete this one"
            )

    def write_manifest(self, suite: Suite, engine: str, agents: dict[str, Any]) -> None:
        """Writes what was run, with what, on what."""
        manifest = {
            "charms_bench": __version__,
            **json.loads(suite.model_dump_json(include=set(_UNDECIDING))),
            "suite": json.loads(suite.model_dump_json(exclude=set(_UNDECIDING))),
            "suite_sha256": suite.fingerprint(),
            "engine": engine,
            "agents": agents,
            "metric_sets": {each.name: each.version for each in METRIC_SETS},
            "versions": recorded_versions(),
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
        """What `write_manifest` wrote.

        Raises:
            RunFolderError: There is none, or it is damaged.
        """
        path = self.path / MANIFEST
        try:
            manifest = json.loads(read_limited(path, FILE_LIMIT_BYTES))
        except OSError as error:
            raise RunFolderError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, RecursionError) as error:
            raise RunFolderError(f"{path}: is no JSON: {error}") from error
        if not isinstance(manifest, dict):
            raise RunFolderError(f"{path}: expected a JSON object")
        return manifest

    def suite(self) -> Suite:
        """The suite whose rows it holds; relative paths in it start nowhere.

        Raises:
            RunFolderError: There is no manifest, or it is damaged.
        """
        manifest = self.manifest()
        try:
            undeciding = {name: manifest[name] for name in _UNDECIDING if name in manifest}
            return Suite.model_validate({**manifest["suite"], **undeciding})
        except (KeyError, TypeError, ValueError) as error:
            reason = str(error).replace("\n", " ")
            raise RunFolderError(f"{self.path / MANIFEST}: describes no suite: {reason}") from error

    def shards(self) -> tuple[Shard, ...]:
        """The finished shards in it, by cell and seed; their `key` is only its beginning.

        Raises:
            RunFolderError: A file has another name than shards have, or is damaged.
        """
        found = []
        for path in sorted((self.path / CHECKSUMS).glob("*.sha256")):
            match = re.fullmatch(r"(\d{3,})-(\d{9,})-([0-9a-f]{16})", path.stem)
            if match is None:
                raise RunFolderError(f"{path}: is no shard of a run; delete it")
            cell, first_seed, key = match.groups()
            rows = self._read("episodes", path.stem)
            found.append(Shard(int(cell), int(first_seed), len(rows), key))
        return tuple(found)

    def has(self, shard: Shard) -> bool:
        """Whether the shard is finished."""
        return self._checksums(shard.name).exists()

    def is_whole(self, shard: Shard) -> bool:
        """Whether the shard is finished and every byte of it as it was written."""
        return self._files(shard.name) is not None

    def write(self, shard: Shard, files: ShardFiles) -> None:
        """Writes a finished shard.

        Raises:
            RunFolderError: The folder cannot be written to.
        """
        for kind in KINDS:
            write_bytes(self._file(kind, shard.name), files[kind])
        write_bytes(self._checksums(shard.name), _checksums(shard.name, files))

    def take(self, shards: Iterable[Shard], other: Path) -> None:
        """Copies the shards that another run has finished, whatever their cells are there.

        Raises:
            RunFolderError: It has none of them.
        """
        has_some = False
        for shard in shards:
            seed_and_key = shard.name.partition("-")[2]
            for path in (other / CHECKSUMS).glob(f"*-{seed_and_key}.sha256"):
                files = RunFolder(other)._files(path.stem)
                has_some = has_some or files is not None
                if files is not None and not self.is_whole(shard):
                    self.write(shard, files)
        if not has_some:
            raise RunFolderError(
                f"{other}: holds no rows of this suite; expected a run of the same version, with "
                "the same engine, scene, seeds and agents"
            )

    def read(self, kind: str, shards: Iterable[Shard]) -> pl.DataFrame:
        """The rows, one of `KINDS`, of some shards.

        Raises:
            RunFolderError: A file is missing or is not as it was written.
        """
        return pl.concat([self._read(kind, shard.name) for shard in shards])

    def _read(self, kind: str, name: str) -> pl.DataFrame:
        path, checksums = self._file(kind, name), self._checksums(name)
        try:
            data = read_limited(path, FILE_LIMIT_BYTES)
            lines = read_limited(checksums, FILE_LIMIT_BYTES).splitlines()
        except OSError as error:
            raise RunFolderError(
                f"{error.filename or path}: cannot be read: {error.strerror}; run the suite again"
            ) from error
        if _checksum(kind, name, data) not in lines:
            raise RunFolderError(
                f"{path}: has changed since it was written, by {checksums}; run the suite again"
            )
        try:
            table = pl.scan_parquet(BytesIO(data))
            if (
                table.collect_schema() == SCHEMAS[kind]
                and table.select(pl.len()).collect().item() <= ROWS_LIMIT
            ):
                return table.collect()
        except pl.exceptions.PolarsError as error:
            raise RunFolderError(f"{path}: is no Parquet file; run the suite again") from error
        raise RunFolderError(f"{path}: holds other rows than runs write; run the suite again")

    def _files(self, name: str) -> ShardFiles | None:
        """The files of a shard; none where they are not as they were written."""
        try:
            files = {kind: read_limited(self._file(kind, name), FILE_LIMIT_BYTES) for kind in KINDS}
            kept = read_limited(self._checksums(name), FILE_LIMIT_BYTES)
        except OSError:
            return None
        return files if kept == _checksums(name, files) else None

    def keep_network(self, network: Path, sha256: str) -> None:
        """Copies a network that the suite gives by its path, so that the folder holds all it had.

        Raises:
            RunFolderError: It is no longer the one of this hash, or the folder cannot be written.
        """
        kept = self._network(sha256)
        data = network.read_bytes()
        if hashlib.sha256(data).hexdigest() != sha256:
            raise RunFolderError(f"{network}: has changed since the run began; run the suite again")
        if not kept.exists() or kept.read_bytes() != data:
            write_bytes(kept, data)

    def network(self, key: str) -> Path | None:
        """The copy of the network that an agent is, by its key; none where there is none."""
        agents = self.manifest().get("agents")
        identity = agents.get(key) if isinstance(agents, dict) else None
        sha256 = identity.get("weights_sha256") if isinstance(identity, dict) else None
        if re.fullmatch(r"[0-9a-f]{64}", str(sha256)) is None:
            return None
        kept = self._network(str(sha256))
        return kept if kept.exists() else None

    def drop_others(self, shards: Iterable[Shard]) -> None:
        """Removes shards of the folder that are no longer part of the run."""
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


def _checksums(name: str, files: ShardFiles) -> bytes:
    """What `sha256sum` says of a shard's files, asked in the run folder."""
    return b"".join(_checksum(kind, name, files[kind]) + b"\n" for kind in KINDS)


def _checksum(kind: str, name: str, data: bytes) -> bytes:
    return f"{hashlib.sha256(data).hexdigest()}  {kind}/{name}.parquet".encode()


def _differences(theirs: Any, ours: Any, at: str = "") -> list[str]:
    """Where two JSON values differ, in words."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        keys = sorted({*theirs, *ours})
        return [
            difference
            for key in keys
            for difference in _differences(theirs.get(key), ours.get(key), f"{at}.{key}")
        ]
    if isinstance(theirs, list) and isinstance(ours, list) and len(theirs) == len(ours):
        return [
            difference
            for index, pair in enumerate(zip(theirs, ours, strict=True))
            for difference in _differences(*pair, f"{at}[{index}]")
        ]
    if theirs == ours:
        return []
    return [f"{at.removeprefix('.suite').lstrip('.')} was {theirs}, now {ours}"]
