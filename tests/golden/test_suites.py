"""Every cell of the suites has the rows that were recorded."""

import csv
from pathlib import Path

import pytest
from rows.cells import EARLIER, PROJECT, rows_of
from rows.history import missing

DATA = Path(__file__).parent / "rows" / "data" / "suites"
SUITES = [path.relative_to(DATA).with_suffix("").as_posix() for path in sorted(DATA.rglob("*.csv"))]
EVERY = {
    "realism": 5,  # those of `environment`
    "roads": 4,
    "transfer/traffics": 3,
    "mutants": 3,
    **dict.fromkeys(("crossplay", "likeness", "likeness-all-speeds", "released/transfer"), 2),
}
"""The suites of which the fast tests compare only every so manieth cell of each traffic model."""
SLOW = "open-road"
"""A suite of long episodes with many vehicles; `crowd-on-open-road` asks about less of the same."""


@pytest.fixture(autouse=True)
def _in_the_project(monkeypatch: pytest.MonkeyPatch) -> None:
    """Suites name populations of human drivers by paths from there."""
    monkeypatch.chdir(PROJECT)


@pytest.mark.parametrize("name", [name for name in SUITES if name != SLOW])
def test_each_cell_of_a_suite_has_its_rows(name: str, tmp_path: Path) -> None:
    said = differences(name, tmp_path, EVERY.get(name, 1))
    assert not said, said


@pytest.mark.slow
@pytest.mark.parametrize("name", [SLOW, *EVERY])
def test_each_cell_of_a_long_suite_has_its_rows(name: str, tmp_path: Path) -> None:
    said = differences(name, tmp_path)
    assert not said, said


def differences(name: str, folder: Path, every: int = 1) -> str:
    """Returns what differs from the recorded rows, by cell. Columns may have been added."""
    if name in EARLIER and (why := missing()):
        pytest.skip(why)
    with (DATA / f"{name}.csv").open(newline="") as file:
        recorded = {(row["ego"], row["traffic"]): row for row in csv.DictReader(file)}
    egos, traffics = ([*dict.fromkeys(each)] for each in zip(*recorded, strict=True))
    chosen = [
        cell for cell in recorded if (egos.index(cell[0]) + traffics.index(cell[1])) % every == 0
    ]
    found = {(row["ego"], row["traffic"]): row for row in rows_of(name, folder, chosen)}
    said = []
    for cell in chosen:
        row, now = recorded[cell], found.get(cell, {"shown": "missing"})
        if changed := [column for column in row if now.get(column) != row[column]]:
            was, now_is = row["shown"], now["shown"]
            said.append(f"{' in '.join(cell)}: {', '.join(changed)}. Was: {was}. Now: {now_is}")
    return "\n".join(said)
