"""Reads CSV files of numbers; errors name the file, the line and the column."""

import math
from collections.abc import Collection, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from charms_bench.errors import DataError, suggestion
from charms_bench.foundation.files import is_compressed, read_limited, size_of

SIZE_LIMIT_BYTES = 2**30
ROW_LIMIT = 5_000_000
"""Twice the rows of a long recording of highD; this bounds the memory of a table."""
_LINE_LIMIT_BYTES = 2**16


class Numbers(NamedTuple):
    """Allowed numbers of a column; the ranges are wide and only catch wrong units and formats."""

    low: float
    high: float
    unit: str = ""
    whole: bool = False

    def allows(self, cell: str) -> bool:
        """Whether the text of a cell is an allowed number."""
        try:
            value = math.nan if "_" in cell else float(cell)
        except ValueError:
            return False
        return self.low <= value <= self.high and not (self.whole and value != math.floor(value))

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        return f"{kind} from {self.low:g} to {self.high:g}{' ' * bool(self.unit)}{self.unit}"


Columns = Mapping[str, Numbers | None]
"""The allowed numbers of each column; None for a column of text, which is not checked."""


def read_table(
    path: Path, columns: Columns, limit: int = SIZE_LIMIT_BYTES, optional: Collection[str] = ()
) -> pl.DataFrame:
    """The named columns of a CSV file; other columns are ignored.

    Line `i + 2` of the file becomes row `i`. Every number is finite and within its range. The file,
    of at most `limit` bytes, may lack `optional` columns, and may have others of text by these
    names.

    Raises:
        DataError: The file cannot be read or is too large, a column is missing, or a value is
            not allowed.
    """
    header = header_of(path, limit)
    columns = {**dict.fromkeys(optional), **columns}
    columns = {name: columns[name] for name in columns if name in header or name not in optional}
    if missing := [name for name in columns if name not in header]:
        readable = [each[:40] for each in header[:40] if each.isprintable()]
        known = suggestion(missing[0], dict.fromkeys(readable))
        names = "', '".join(missing)
        raise DataError(f"{path}: line 1: no column{'s' * (len(missing) > 1)} '{names}'. {known}")
    for name in columns:
        if header.count(name) > 1:
            raise DataError(f"{path}: line 1: the column '{name}' appears twice")
    numbers = {name: cells for name, cells in columns.items() if cells is not None}
    types = {name: pl.Float64 if name in numbers else pl.String for name in columns}
    options: dict[str, Any] = {"n_rows": ROW_LIMIT + 1, "glob": False}
    options["quote_char"] = '"' if _is_quoted(path) else None
    try:
        with path.open("rb") as file:  # polars cannot open every name that a file can have
            scanned = pl.scan_csv(file, schema_overrides=types, **options)
            table = scanned.select(*columns).collect()
        usable = all(_usable(table[name], allowed) for name, allowed in numbers.items())
    except pl.exceptions.PolarsError as error:
        reason = str(error).partition("\n")[0]
        raise _first_mistake(path, header, numbers, f"not a CSV table: {reason}") from error
    if table.height > ROW_LIMIT:
        raise DataError(f"{path}: more than {ROW_LIMIT:,} rows; split the recording")
    # An extra field shifts the rest of its line, and polars may not report that.
    with path.open("rb") as file:
        commas = sum(block.count(b",") for block in iter(lambda: file.read(2**20), b""))
    if not usable or commas != (len(header) - 1) * (table.height + 1):
        raise _first_mistake(path, header, numbers, "not a CSV table of numbers")
    whole = [name for name, allowed in numbers.items() if allowed.whole]
    return table.with_columns(pl.col(whole).cast(pl.Int64))


def read_parquet(path: Path) -> pl.DataFrame:
    """A Parquet table with the same limits; raises a `DataError`."""
    try:
        data = read_limited(path, SIZE_LIMIT_BYTES)
        table = pl.read_parquet(BytesIO(data), n_rows=ROW_LIMIT + 1)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    except pl.exceptions.PolarsError as error:
        reason = str(error).partition("\n")[0]
        raise DataError(f"{path}: not a Parquet table: {reason}") from error
    if table.height > ROW_LIMIT:
        raise DataError(f"{path}: more than {ROW_LIMIT:,} rows; split the recording")
    return table


def reject(path: Path, table: pl.DataFrame, mistaken: pl.Expr, column: str, what: str) -> None:
    """Raises an error about the first line that is mistaken; `{}` in `what` is its value.

    The table has the number of each `line`.
    """
    found = table.filter(mistaken).sort("line")
    for line, value in found.select("line", column).head(1).iter_rows():
        raise DataError(f"{path}: line {line}: {what.format(value)}")


def header_of(path: Path, limit: int = SIZE_LIMIT_BYTES) -> list[str]:
    """The names of a table's columns; raises a `DataError` for a file that must not be read."""
    try:
        if size_of(path) > limit:
            raise DataError(f"{path}: larger than {limit:,} bytes; split the recording")
        with path.open("rb") as file:
            first = file.readline(_LINE_LIMIT_BYTES)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    if is_compressed(first):
        raise DataError(f"{path}: is compressed; expected text, so decompress it first")
    if not first.strip():
        raise DataError(f"{path}: line 1: empty; expected the names of the columns")
    if len(first) == _LINE_LIMIT_BYTES:
        raise DataError(f"{path}: line 1: longer than {_LINE_LIMIT_BYTES:,} bytes")
    return _cells(first.decode("utf-8-sig", errors="replace"))


def _cells(line: str) -> list[str]:
    """The cells of a line, without quotes around them."""
    cells = line.rstrip("\r\n").split(",")
    return [c[1:-1] if len(c) > 1 and c[0] == c[-1] == '"' else c for c in cells]


def _is_quoted(path: Path) -> bool:
    """Whether the names of the columns are in quotes, so that cells may be, too."""
    with path.open("rb") as file:
        return b'"' in file.readline(_LINE_LIMIT_BYTES)


def _usable(values: pl.Series, allowed: Numbers) -> bool:
    within = values.is_between(allowed.low, allowed.high)  # NaN and infinities are in no range
    whole = not allowed.whole or (values == values.floor()).all()
    return bool(within.fill_null(False).all()) and whole


def _first_mistake(
    path: Path, header: list[str], numbers: Mapping[str, Numbers], otherwise: str
) -> DataError:
    """The error in the first wrong line, found by reading line by line."""
    with path.open("rb") as file:
        lines = iter(lambda: file.readline(_LINE_LIMIT_BYTES), b"")
        next(lines)
        for number, line in enumerate(lines, start=2):
            if len(line) == _LINE_LIMIT_BYTES:
                return DataError(f"{path}: line {number}: longer than {_LINE_LIMIT_BYTES:,} bytes")
            fields = _cells(line.decode(errors="replace"))
            if not line.strip():
                return DataError(f"{path}: line {number}: is empty; remove it")
            if len(fields) != len(header):
                return DataError(
                    f"{path}: line {number}: {len(fields)} fields, but the header has "
                    f"{len(header)}; is the file cut short?"
                )
            for name, cell in zip(header, fields, strict=True):
                if name in numbers and not numbers[name].allows(cell):
                    found = f"'{cell[:40]}'" if cell else "nothing"
                    where = f"{path}: line {number}: column '{name}'"
                    return DataError(f"{where}: expected {numbers[name]}, found {found}")
    return DataError(f"{path}: {otherwise}")
