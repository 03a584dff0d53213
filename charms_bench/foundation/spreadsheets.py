"""CSV files whose texts a spreadsheet shows, and never computes.

A spreadsheet takes a cell for a formula if it begins with one of `=+-@`, also in full width, or
with a tab or the end of a line. An apostrophe before it makes it a text (OWASP, CSV injection).
"""

import polars as pl
import polars.selectors as cs

_FORMULA = r"'*[=+\-@\t\r\n\uFF1D\uFF0B\uFF0D\uFF20]"


def in_csv(table: pl.DataFrame) -> bytes:
    """Returns a table as CSV; texts that would be formulas begin with an apostrophe."""
    return table.with_columns(cs.string().str.replace(f"^({_FORMULA})", "'$1")).write_csv().encode()


def from_csv(table: pl.DataFrame) -> pl.DataFrame:
    """Returns a table that was read from CSV without the apostrophes of `in_csv`."""
    return table.with_columns(cs.string().str.replace(f"^'({_FORMULA})", "$1"))
