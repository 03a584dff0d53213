"""A run folder: its manifest and its shards, written whole or not at all."""

import json
import os
import platform
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench import __version__
from charms_bench.errors import RunFolderError
from charms_bench.suite import PRESENTATION, Suite

MANIFEST = "manifest.json"
KINDS = ("steps", "counts", "episodes")
"""The kinds of rows of a shard, as `Recording` has them, each in a folder of its own."""
_UNDECIDING = ("episodes", *PRESENTATION)
"""Fields of a suite that decide no row."""
_RECORDED_VERSIONS = ("highway-env", "numba", "numpy", "onnxruntime", "polars")


ShardFiles = Mapping[str, bytes]
"""The Parquet files of a shard, by kind: one a kind of `KINDS`."""


def in_parquet(rows: pl.DataFrame) -> bytes:
    """Rows as a Parquet file."""
    file = BytesIO()
    rows.write_parquet(file)
    return file.getvalue()


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Lets `write` fill a file beside `path` and then puts it in its place.

    Raises:
        RunFolderError: The folder cannot be written to.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write(partial)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be written: {error.strerror or error}") from error


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

    def open_for(self, suite: Suite, engine: str) -> None:
        """Makes the folder this suite's; one that holds another run is left alone.

        Raises:
            RunFolderError: It holds another run, or cannot be read or written.
        """
        manifest = self.path / MANIFEST
        fields = json.loads(suite.model_dump_json(exclude=set(_UNDECIDING)))
        ours = {"suite": fields, "engine": engine}
        if manifest.exists():
            theirs = self.manifest()
            for difference in _differences({key: theirs.get(key) for key in ours}, ours):
                raise RunFolderError(
                    f"{self.path} holds another run: {difference}; "
                    "choose another folder with --output, or delete this one"
                )
        elif self.path.exists() and any(self.path.iterdir()):
            raise RunFolderError(
                f"{self.path} is not empty and holds no run; choose another with --output"
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
            "versions": {name: version(name) for name in _RECORDED_VERSIONS},
            "machine": {
                "python": platform.python_version(),
                "system": platform.system(),
                "processor": platform.machine(),
                "cpus": os.cpu_count(),
            },
        }
        text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
        write_atomically(self.path / MANIFEST, lambda path: path.write_text(text, encoding="utf-8"))

    def manifest(self) -> dict[str, Any]:
        """What `write_manifest` wrote.

        Raises:
            RunFolderError: There is none, or it is damaged.
        """
        path = self.path / MANIFEST
        try:
            manifest = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise RunFolderError(f"{path}: cannot be read: {error.strerror}") from error
        except ValueError as error:
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
            RunFolderError: A file has another name than shards have.
        """
        found = []
        for path in sorted((self.path / "episodes").glob("*.parquet")):
            match = re.fullmatch(r"(\d{3,})-(\d{9,})-([0-9a-f]{16})", path.stem)
            if match is None:
                raise RunFolderError(f"{path}: is no shard of a run; delete it")
            cell, first_seed, key = match.groups()
            with _reading(path):
                episodes = pl.scan_parquet(path, glob=False).select(pl.len()).collect().item()
            found.append(Shard(int(cell), int(first_seed), episodes, key))
        return tuple(found)

    def has(self, shard: Shard) -> bool:
        """Whether the shard is finished."""
        return all(self._file(kind, shard).exists() for kind in KINDS)

    def write(self, shard: Shard, files: ShardFiles) -> None:
        """Writes a finished shard."""
        for kind in KINDS:
            write_atomically(self._file(kind, shard), partial(_write_bytes, files[kind]))

    def take(self, shards: Iterable[Shard], other: Path) -> None:
        """Copies the shards that another run has finished, whatever their cells are there.

        Raises:
            RunFolderError: It has none of them.
        """
        has_some = False
        for shard in shards:
            seed_and_key = shard.name.partition("-")[2]
            found = {
                kind: path
                for kind in KINDS
                for path in (other / kind).glob(f"*-{seed_and_key}.parquet")
            }
            if len(found) < len(KINDS):
                continue
            has_some = True
            if not self.has(shard):
                for kind, path in found.items():
                    write_atomically(self._file(kind, shard), partial(shutil.copyfile, path))
        if not has_some:
            raise RunFolderError(
                f"{other}: holds no rows of this suite; expected a run of the same version, with "
                "the same engine, scene, seeds and agents"
            )

    def read(self, kind: str, shards: Iterable[Shard]) -> pl.DataFrame:
        """The rows, one of `KINDS`, of some shards.

        Raises:
            RunFolderError: A file is missing or damaged.
        """
        frames = []
        for shard in shards:
            path = self._file(kind, shard)
            with _reading(path):
                frames.append(pl.read_parquet(path, glob=False))
        return pl.concat(frames)

    def drop_others(self, shards: Iterable[Shard]) -> None:
        """Removes shards of the folder that are no longer part of the run."""
        names = {f"{shard.name}.parquet" for shard in shards}
        for kind in KINDS:
            for path in sorted((self.path / kind).glob("*.parquet")):
                if path.name not in names:
                    path.unlink()

    def _file(self, kind: str, shard: Shard) -> Path:
        return self.path / kind / f"{shard.name}.parquet"


def _write_bytes(data: bytes, path: Path) -> None:
    path.write_bytes(data)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Says of which file it is that polars cannot read it."""
    try:
        yield
    except (OSError, pl.exceptions.PolarsError) as error:
        reason = str(error).splitlines()[0]
        raise RunFolderError(
            f"{path}: cannot be read: {reason}; delete it and run again"
        ) from error


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
