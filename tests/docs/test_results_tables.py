"""The tables of the readme and the documentation are those of runs."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import polars as pl
import pytest
from written import PAGES, ROOT

from charms_bench.report.markdown import markdown
from charms_bench.report.suite_table import KEYS, LONG, from_frame
from charms_bench.report.table import long_schema
from charms_bench.runs.suite import Suite


@pytest.fixture(scope="module")
def tool() -> Iterator[ModuleType]:
    sys.path.insert(0, str(ROOT / "tools"))
    import write_results

    yield write_results
    sys.path.remove(str(ROOT / "tools"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_has_the_tables_that_were_written_last(tool: ModuleType, page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert tool.filled(text) == text, "python tools/write_results.py RUNS"


def test_every_table_is_on_a_page(tool: ModuleType) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    used = {found[2] for found in tool.BLOCK.finditer(text)}
    assert used == set(tool.TABLES) == {path.stem for path in tool.RESULTS.glob("*.md")}


def test_a_number_has_its_interval_and_the_papers_value(tool: ModuleType) -> None:
    rows = [
        ("IDM", "mixed", "paper-2", "speed_mean", 23.676, 23.6, 23.7, 100, 23.67),
        ("IDM", "mixed", "standard-2", "speed_mean", 25.0, 24.9, 25.1, 100, None),
        ("IDM", "mixed", "standard-2", "crashed_episodes", 0.0301, 0.023, 0.0391, 100, None),
        ("other", "mixed", "paper-2", "speed_mean", None, None, None, 0, None),
        ("other", "mixed", "standard-2", "crashed_episodes", 0.0, None, None, 100, None),
    ]
    suite = {"suite": "s", "episodes": 1, "egos": [{"agent": "a"}], "traffics": [{"traffic": "t"}]}
    long = pl.DataFrame(rows, schema=long_schema(KEYS, LONG), orient="row")
    table = from_frame(long, Suite.model_validate(suite))
    columns = {name: tool.EGO[name] for name in ("episodes crashed", "speed, m/s")}
    shown = tool.shown(table, columns)
    assert markdown(shown).splitlines() == [
        "| agent | episodes crashed | speed, m/s (paper) |",
        "|---|---:|---:|",
        "| IDM | 3.0 % [2.3, 3.9] | 23.68 (23.67) |",
        "| other | 0.0 % | – |",
    ]
