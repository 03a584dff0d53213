"""The tables of the readme and the documentation are those of runs."""

import math
import re
from pathlib import Path

import polars as pl
import pytest
from rare_comparison import rare_comparison
from reproduction import side_by_side, with_verdicts
from result_pages import RESULTS, table_named, tables
from run_results import how_late
from suite_results import EGO, shown
from write_results import TABLES
from written import PAGES, ROOT

from charms_bench.episodes.avoidability import Avoidability
from charms_bench.report.markdown import markdown
from charms_bench.report.suite_table import KEYS, LONG, from_frame
from charms_bench.report.table import long_schema
from charms_bench.runs.suite import Suite

NUMBERS = ("value", "low", "high")
REPRODUCTIONS = ("reproduction-ego", "reproduction-styles", "reproduction-environment")


def test_every_table_is_on_a_page_and_says_the_same_on_all() -> None:
    found: dict[str, set[str]] = {}
    for _, name, text in tables():
        found.setdefault(name, set()).add(text)
    assert [name for name, texts in found.items() if len(texts) > 1] == []
    # rare_coverage, rare_comparison.py, likeness_page and mutants write the others.
    written = {*TABLES, "rare-coverage", "rare-intervals", "mutants", "mutants-ladders",
               "mutants-roads", "mutants-repetitions", "mutants-repeated-faults"}  # fmt: skip
    written |= {f"likeness-{road}{part}" for road in ("i24", "i75", "released")
                for part in ("", "-conduct")}  # fmt: skip
    written |= {"likeness-controls-i24", "likeness-controls-i75"}
    # Those of the plans are named by their tools.
    assert {name for name in found if not name.startswith("plan-")} == written


def test_a_number_has_its_interval_and_the_papers_value() -> None:
    rows = [
        ("IDM", "mixed", "paper-2", "speed_mean", 23.676, 23.6, 23.7, 100, 23.67),
        ("IDM", "mixed", "standard-5", "speed_mean", 25.0, 24.9, 25.1, 100, None),
        ("IDM", "mixed", "standard-5", "crashed_episodes", 0.0301, 0.023, 0.0391, 100, None),
        ("other", "mixed", "paper-2", "speed_mean", None, None, None, 0, None),
        ("other", "mixed", "standard-5", "crashed_episodes", 0.0, None, None, 100, None),
    ]
    suite = {"suite": "s", "episodes": 1}
    suite |= {"egos": [{"agent": "a"}], "traffic_models": [{"traffic": "t"}]}
    long = pl.DataFrame(rows, schema=long_schema(KEYS, LONG), orient="row")
    table = from_frame(long, Suite.model_validate(suite))
    columns = {name: EGO[name] for name in ("episodes crashed", "speed, m/s")}
    assert markdown(shown(table, columns)).splitlines() == [
        "| agent | episodes crashed | speed, m/s (paper) |",
        "|---|---:|---:|",
        "| IDM | 3.0 % [2.3, 3.9] | 23.68 (23.67) |",
        "| other | 0.0 % | – |",
    ]


def test_collisions_are_counted_by_the_decisions_that_were_left() -> None:
    fields = {"ego": "A", "traffic": "T", "ending": "side", "replacement": None, "nodes": 1}
    fields |= {"collided_s": 9.9}
    found = [
        Avoidability(
            **fields, episode=k, step=30, verdict=verdict, last_step=last, avoided_by=by, hit_by=hit
        )
        for k, (verdict, last, by, hit) in enumerate(
            [
                ("avoidable", 30, ("b",), ("c",)),
                ("avoidable", 26, ("b", "c"), ()),
                ("avoidable", 26, (), ("b", "c")),
                ("spawn", None, (), ()),
            ]
        )
    ]
    words, late, who = how_late(found, 3).split("\n\n")
    assert words.startswith("4 collisions of the ego: 3 avoidable")
    assert late.splitlines()[2:] == ["| 1 | 0.33 | 1 |", "| 5 | 1.67 | 2 |"]
    assert who.splitlines()[2:] == ["| b | 2 | 3 |", "| c | 1 | 3 |"]


def test_the_table_of_rare_events_compares_at_equal_width(tmp_path: Path) -> None:
    # Width of an interval of n plain episodes of probability p: exp(2 * 1.96 / sqrt(n p)) between
    # its ends. Ends a factor of e apart give n = (2 * 1.96)**2 / p = 15.4 / p, with p = 1e-4.
    tables = tmp_path / "rare" / "tables"
    tables.mkdir(parents=True)
    rows = [("probability", 1e-4, 1e-4 / math.e**0.5, 1e-4 * math.e**0.5, 30_800)]
    rows += [("episodes", 30_800, None, None, None)]
    table = pl.DataFrame(rows, schema=["name", "value", "low", "high", "n"], orient="row")
    table.write_csv(tables / "rare-rare-crash.csv")
    *_, line = rare_comparison(tmp_path / "rare").splitlines()
    assert line == (
        "| `charms-bench rare` | 1.00e-04 [6.07e-05, 1.65e-04] | 30,800 | 150,000 | 4.9 |"
    )


@pytest.mark.parametrize("name", REPRODUCTIONS)
def test_a_table_of_the_reproduction_is_that_of_its_numbers(name: str) -> None:
    numbers = pl.read_csv(RESULTS / f"{name}.csv")
    assert side_by_side(numbers) == table_named(name)


def test_a_value_agrees_if_two_samples_of_its_size_differ_as_much() -> None:
    parts = [f"{source}_{part}" for source in ("released", "ours") for part in NUMBERS]
    columns = ["agent", "metric", "paper", *parts]
    rows = [
        # The column has two digits, so 23.10 means 23.095 to 23.105. The difference of 0.095 is
        # less than sqrt(2) * 0.1 = 0.141; that of 0.395 is sqrt(2) * 0.1 / 1.96 * 5.5.
        ("A", "speed_mean", 23.1, 23.2, 23.1, 23.3, 22.7, 22.6, 22.8),
        ("B", "speed_mean", 23.67, 23.6, 23.47, 23.73, 23.668, None, None),
        ("B", "crashed_episodes", None, 0.25, 0.2, 0.3, None, None, None),
    ]
    numbers = with_verdicts(pl.DataFrame(rows, schema=columns, orient="row"))
    assert numbers["released_agrees"].to_list() == ["yes", "yes", None]
    assert numbers["ours_agrees"].to_list() == ["no, 5.5", "yes", None]
    *table, empty, summary = side_by_side(numbers).splitlines()
    assert not empty
    assert summary == (
        "Of the values of the authors' networks, 2 of 2 agree with the paper; of this project's, "
        "1 of 2."
    )
    assert table == [
        "| agent | source | speed, m/s | episodes crashed, % |",
        "|---|---|---:|---:|",
        "| A | paper | 23.10 | – |",
        "| A | authors' networks | **23.20** | – |",
        "| A | this project | 22.70 | – |",
        "| B | paper | 23.67 | – |",
        "| B | authors' networks | **23.60** | 25.0 |",
        "| B | this project | **23.67** | – |",
    ]


def test_a_link_to_numbers_leads_to_their_file() -> None:
    linked = {
        name
        for page in PAGES
        for name in re.findall(r"\]\((results/[a-z-]+\.csv)\)", page.read_text(encoding="utf-8"))
    }
    assert {"results/crossplay.csv", "results/transfer.csv"} <= linked
    assert [name for name in linked if not (ROOT / "docs" / name).is_file()] == []
