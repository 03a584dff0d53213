"""Tables as a run folder keeps them: read again, not computed again."""

import re
from collections.abc import Mapping
from pathlib import Path

import polars as pl
import polars.selectors as cs

from charms_bench.errors import RunFolderError
from charms_bench.report.pairs import SCHEMA as PAIRS_SCHEMA
from charms_bench.report.realism import SCHEMA as REALISM_SCHEMA
from charms_bench.report.tables import LONG_SCHEMA
from charms_bench.runs.folder import FILE_LIMIT_BYTES
from charms_bench.world.files import read_limited

TABLES: dict[str, Mapping[str, pl.DataType]] = {
    "": LONG_SCHEMA,
    "-realism": REALISM_SCHEMA,
    "-pairs": PAIRS_SCHEMA,
}
"""What is written of a suite, by the end of its name: every cell, realism, pairs of egos."""

CONTROL_CODES = re.compile(r"[\x00-\x1f\x7f-\x9f]")


def holds(folder: Path, name: str) -> bool:
    """Whether a run folder has a file of this name.

    Raises:
        RunFolderError: One may not look into it, or no folder can be called that.
    """
    try:
        return (folder / name).exists()
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be read: {error.strerror}") from error


def stored_tables(folder: Path, suite: str) -> dict[str, pl.DataFrame]:
    """The tables of an evaluation, by the ends of their names (`TABLES`).

    Args:
        folder: The run folder.
        suite: The suite's name.

    Raises:
        RunFolderError: The first, which every run has, is missing, or one is damaged.
    """
    paths = {end: folder / "tables" / f"{suite}{end}.csv" for end in TABLES}
    if not paths[""].exists():
        raise RunFolderError(
            f"{paths['']}: no such file; a run writes its tables when it is finished, and "
            f"`charms-bench rescore {folder}` writes them again"
        )
    return {end: read_table(path, TABLES[end]) for end, path in paths.items() if path.exists()}


def read_table(path: Path, schema: Mapping[str, pl.DataType]) -> pl.DataFrame:
    """A CSV file with these columns; see `read_csv`.

    Raises:
        RunFolderError: It cannot be read, or has other columns.
    """
    table = read_csv(path, schema)
    if table.columns != list(schema):
        raise RunFolderError(
            f"{path}: expected the columns {', '.join(schema)}, found {', '.join(table.columns)}"
        )
    return table


def read_csv(path: Path, schema: Mapping[str, pl.DataType] | None = None) -> pl.DataFrame:
    """A CSV file that can be shown: a number that is not finite is null.

    Raises:
        RunFolderError: It cannot be read, or has control characters in it.
    """
    try:
        data = read_limited(path, FILE_LIMIT_BYTES)
        table = pl.read_csv(data, schema_overrides=schema, infer_schema_length=None)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror}") from error
    except pl.exceptions.PolarsError as error:
        raise RunFolderError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from error
    words = [*table.columns, *(word for column in table.select(cs.string()) for word in column)]
    if strange := [word for word in words if CONTROL_CODES.search(word or "")]:
        raise RunFolderError(f"{path}: has control characters: {strange[0]!a}; write it again")
    numbers = cs.float()
    return table.with_columns(pl.when(numbers.is_finite()).then(numbers))
