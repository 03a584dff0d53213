"""Reads the tables that a run folder holds, instead of computing them again."""

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import polars as pl
import polars.selectors as cs

from charms_bench.errors import RunFolderError
from charms_bench.foundation.files import is_compressed, read_file
from charms_bench.foundation.spreadsheets import from_csv
from charms_bench.report import (
    drivers_table,
    pairs_table,
    preventable_table,
    realism_table,
    suite_table,
)
from charms_bench.report.table import Table, long_schema
from charms_bench.runs.suite import Suite

TABLE_LIMIT_BYTES = 2**26
"""Far more than a table has of 10,000 cells or a training of many stages."""
SUMS = "SHA256SUMS"
"""The file in `tables` with the checksums of its files, in the format of `sha256sum`."""
CONTROL_CODES = re.compile(r"[\x00-\x1f\x7f-\x9f]")


@dataclass(frozen=True)
class RunTables:
    """The tables of a run; None for those that its suite does not call for."""

    metrics: Table
    """Every metric of every cell."""
    realism: Table | None
    """How far each traffic is from human driving."""
    pairs: Table | None
    """The differences between each two egos."""
    preventable: Table | None
    """The collisions that a reference driver avoids in the same episodes."""
    drivers: Table | None
    """What each driver does to others and what others do to it."""

    def each(self) -> list[Table]:
        """The tables that the run has."""
        return [table for table in vars(self).values() if table is not None]


def holds(folder: Path, name: str) -> bool:
    """Whether a run folder has a file of this name; a `RunFolderError` if it cannot be read."""
    try:
        if not folder.is_dir():
            raise RunFolderError(f"{folder}: no such folder")
        return (folder / name).exists()
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be read: {error.strerror}") from error


def stored_tables(folder: Path, suite: Suite) -> RunTables:
    """The tables in the folder of a suite's run.

    A `RunFolderError` if that of metrics, which every run has, is missing, or one is damaged.
    """
    start = folder / "tables" / suite.suite
    kinds = (
        ("", suite_table, True),
        ("-realism", realism_table, bool(suite.references)),
        ("-pairs", pairs_table, suite.pairs),
        ("-preventable", preventable_table, suite.preventable_by is not None),
        ("-drivers", drivers_table, True),
    )
    metrics, realism, pairs, preventable, drivers = (
        kind.from_frame(read_table(path, long_schema(keys, kind.LONG)), suite)
        if (path := Path(f"{start}{ending}.csv")).exists() and is_asked
        else None
        for ending, kind, is_asked in kinds
        for keys in [kind.KEYS if kind is realism_table else suite.with_road(kind.KEYS)]
    )
    if metrics is None:
        raise RunFolderError(
            f"{start}.csv: no such file; a run writes its tables when it is finished, and "
            f"`charms-bench rescore {folder}` writes them again"
        )
    return RunTables(metrics, realism, pairs, preventable, drivers)


def sums_in(tables: Path) -> dict[str, str]:
    """The SHA-256 of the files in a folder `tables`, by name; earlier versions wrote none."""
    path = tables / SUMS
    text = read_file(path, TABLE_LIMIT_BYTES).decode(errors="replace") if path.exists() else ""
    return {
        name: sha256 for sha256, _, name in (line.partition("  ") for line in text.splitlines())
    }


def read_written(path: Path) -> bytes:
    """A file of `tables`; a `RunFolderError` if it does not match its checksum."""
    data = read_file(path, TABLE_LIMIT_BYTES)
    found = hashlib.sha256(data).hexdigest()
    if sums_in(path.parent).get(path.name, found) != found:
        raise RunFolderError(
            f"{path}: does not match its checksum in {path.with_name(SUMS)}, so it has changed "
            "since it was written; the command that made the folder writes it again"
        )
    return data


def read_table(
    path: Path, schema: Mapping[str, pl.DataType], read: Callable[[Path], bytes] = read_written
) -> pl.DataFrame:
    """A CSV file with exactly these columns; a `RunFolderError` for others. See `read_csv`."""
    table = read_csv(path, schema, read)
    if table.columns != list(schema):
        raise RunFolderError(
            f"{path}: expected the columns {', '.join(schema)}, found {', '.join(table.columns)}"
        )
    return table


def read_csv(
    path: Path,
    schema: Mapping[str, pl.DataType] | None = None,
    read: Callable[[Path], bytes] = read_written,
) -> pl.DataFrame:
    """A CSV file that can be shown; a number that is not finite becomes null.

    A `RunFolderError` if it cannot be read, has changed, or has control characters in it.
    """
    data = read(path)
    if is_compressed(data):
        raise RunFolderError(f"{path}: is compressed; expected the text of a CSV file")
    try:
        table = pl.read_csv(data, schema_overrides=schema, infer_schema_length=None)
    except pl.exceptions.PolarsError as error:
        raise RunFolderError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from error
    words = [*table.columns, *(word for column in table.select(cs.string()) for word in column)]
    if strange := [word for word in words if CONTROL_CODES.search(word or "")]:
        raise RunFolderError(f"{path}: has control characters: {strange[0]!a}; write it again")
    numbers = cs.float()
    return from_csv(table.with_columns(pl.when(numbers.is_finite()).then(numbers)))
