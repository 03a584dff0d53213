"""Tables are read back from a run folder."""

from pathlib import Path

import polars as pl
import pytest
from ego_table import EGO, SUITE

from charms_bench.errors import RunFolderError
from charms_bench.report.run_files import write_table
from charms_bench.report.stored import read_table, stored_tables
from charms_bench.report.suite_table import KEYS, LONG, from_frame
from charms_bench.report.table import long_schema

SCHEMA = long_schema(KEYS, LONG)


def test_a_stored_table_is_the_table_that_was_written(tmp_path: Path) -> None:
    (tmp_path / "ego.csv").write_text(EGO)
    table = from_frame(read_table(tmp_path / "ego.csv", SCHEMA), SUITE)
    path = write_table(tmp_path, table)
    assert sorted(path.with_suffix(".csv").read_text().splitlines()) == sorted(EGO.splitlines())
    assert stored_tables(tmp_path, SUITE).metrics == table
    assert (table.columns[0].unit, table.columns[0].counted) == ("m/s", "decisions near a leader")


def test_a_set_that_is_not_installed_is_said_to_be_unknown() -> None:
    frame = pl.DataFrame(
        [("a", "t", "mine-7", "fun", 1.0, None, None, 1, None)], SCHEMA, orient="row"
    )
    (column,) = from_frame(frame, SUITE).columns
    assert column.definition.startswith("Unknown: the metric set mine-7 is not installed")


def test_a_run_without_tables_is_told_what_writes_them(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match=r"ego\.csv: no such file.*charms-bench rescore"):
        stored_tables(tmp_path, SUITE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("agent,value\nIDM,1\n", "expected the columns agent, traffic, metric_set"),
        (EGO.replace("24.0,23.5", "fast,23.5"), "cannot be read: could not parse `fast`"),
        ("", "cannot be read"),
        (EGO.replace("CHARMS", "\x1b[2J"), r"has control characters: '\\x1b\[2J'"),
    ],
)
def test_a_damaged_table_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "ego.csv"
    path.write_text(text)
    with pytest.raises(RunFolderError, match=message) as rejected:
        read_table(path, SCHEMA)
    assert str(path) in str(rejected.value)


def test_a_number_that_is_not_finite_is_none(tmp_path: Path) -> None:
    path = tmp_path / "ego.csv"
    path.write_text(EGO.replace("24.0,23.5", "inf,nan"))
    assert read_table(path, SCHEMA).row(0)[4:6] == (None, None)
