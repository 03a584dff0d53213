"""Episodes of a run as a dataset for other tools, simulated again."""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Literal

import polars as pl

from charms_bench.episodes.edge_cases import AT_ONCE
from charms_bench.episodes.highd_format import drivers, write_recording
from charms_bench.episodes.minari_dataset import check_name, check_policy, write_minari
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import replay
from charms_bench.errors import InputError, RunFolderError, suggestion
from charms_bench.foundation.files import write_bytes
from charms_bench.foundation.names import distinct, slugs
from charms_bench.foundation.spreadsheets import in_csv
from charms_bench.foundation.words import counted
from charms_bench.runs.lock import folder_in
from charms_bench.runs.shard import in_parquet
from charms_bench.runs.suite import Cell, Suite

Format = Literal["minari", "highd", "parquet"]
FORMATS: tuple[Format, ...] = ("minari", "highd", "parquet")
DRIVERS = "drivers.csv"
"""Beside the recordings in highD's format: which agent drives which vehicle."""


def write_dataset(
    recorded: RecordedCell,
    kind: Format,
    count: int | None,
    output: Path | None,
    tell: Callable[[int], object],
) -> Path:
    """Writes the first `count` episodes of a cell into a new folder, and returns the folder.

    By default, all episodes are written into a folder in the run folder. `tell` is called with the
    number of episodes that have been written. Raises an `InputError` if the folder exists or the
    format does not fit, and what `replay` raises.
    """
    if kind not in FORMATS:
        raise InputError(f"no format '{kind}'. {suggestion(kind, dict.fromkeys(FORMATS))}")
    if kind == "highd":
        recorded.cell.scene.check_straight("highD's format describes")
    suite = recorded.run.suite
    if count is not None and not 1 <= count <= suite.episodes:
        raise InputError(
            f"{counted(count, 'episode')}; expected 1 to {suite.episodes}, which the run has"
        )
    # Minari takes the end of a name for the version of a dataset.
    name = f"{name_of(suite, recorded.cell)}-{'v0' if kind == 'minari' else kind}"
    path = output or folder_in(recorded.run.folder.path, "datasets") / name
    if kind == "minari":
        check_name(path)
        check_policy(recorded)
    episodes = range(suite.seed, suite.seed + (count or suite.episodes))
    with _new_folder(path) as partial:
        if kind == "minari":
            write_minari(recorded, episodes, partial, path.name, tell)
        else:
            _write_replays(recorded, kind, episodes, partial, tell)
    return path


def name_of(suite: Suite, cell: Cell) -> str:
    """Returns a name for files about a cell of a suite, which no other cell of it has."""
    egos = slugs(entry.title for entry in suite.egos)
    places = slugs(entry.title for entry in suite.surroundings)
    names = distinct(f"{ego}-in-{place}" for ego, place in product(egos, places))
    return names[suite.cells.index(cell)]


def _write_replays(
    recorded: RecordedCell,
    kind: Format,
    episodes: Sequence[int],
    path: Path,
    tell: Callable[[int], object],
) -> None:
    names = []
    for first in range(0, len(episodes), AT_ONCE):
        for replayed in replay(recorded, episodes[first : first + AT_ONCE]):
            if kind == "parquet":
                episode = pl.lit(replayed.episode, pl.UInt64).alias("episode")
                rows = replayed.trajectories().select(episode, "*")
                write_bytes(path / f"{replayed.episode:02}.parquet", in_parquet(rows))
            else:
                write_recording(replayed, path)
                names.append(drivers(replayed))
            tell(1)
    if names:
        write_bytes(path / DRIVERS, in_csv(pl.concat(names)))


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Yields an empty folder, which becomes `path` at the end or is deleted."""
    try:
        if path.exists():
            raise InputError(f"{path}: already exists; delete it, or choose another with --output")
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        try:
            partial.mkdir(parents=True)
            yield partial
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be written: {error.strerror or error}") from error
