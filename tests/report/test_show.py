"""Stored tables as a terminal shows them."""

from pathlib import Path

import polars as pl
import pytest
from rich.console import Console, RenderableType

from charms_bench.errors import RunFolderError
from charms_bench.report import training
from charms_bench.report.pairs import SCHEMA as PAIRS_SCHEMA
from charms_bench.report.show import chosen_metrics, render
from charms_bench.report.stored import read_table, stored_tables
from charms_bench.report.tables import LONG_SCHEMA

HEADER = ",".join(LONG_SCHEMA)
EGO = f"""\
{HEADER}
IDM,mixed,paper-1,speed_mean,24.0,23.5,24.5,100,24.2
CHARMS,mixed,paper-1,speed_mean,30.0,29.0,31.0,100,
IDM,mixed,paper-1,dhw_mean,40.0,39.0,41.0,100,
CHARMS,mixed,paper-1,dhw_mean,,,,0,
IDM,mixed,standard-1(ttc_s=2),speed_mean,25.0,24.0,26.0,100,
CHARMS,mixed,standard-1(ttc_s=2),speed_mean,31.0,30.0,32.0,100,
"""


def lines(shown: RenderableType, width: int = 80) -> list[str]:
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        console.print(shown)
    return [line.rstrip() for line in capture.get().splitlines()]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "ego.csv").write_text(EGO)
    return tmp_path


def test_every_value_has_its_interval_as_numbers_and_as_a_bar(folder: Path) -> None:
    shown = lines(render(stored_tables(folder, "ego"), ["speed_mean"], width=60), width=60)
    assert shown[1:5] == [
        "paper-1",
        "speed_mean                 m/s  23.5               31  paper",
        "  IDM       24.00  23.50–24.50  ━●◇━                   24.20",
        "  CHARMS    30.00  29.00–31.00                 ━━●━━━",
    ]


def test_units_are_those_of_the_set_whatever_its_thresholds(folder: Path) -> None:
    shown = lines(render(stored_tables(folder, "ego"), []))
    place = shown.index("standard-1(ttc_s=2)")
    assert shown[place + 1].split()[:2] == ["speed_mean", "m/s"]


def test_what_is_not_defined_is_a_dash_without_a_bar(folder: Path) -> None:
    shown = lines(render(stored_tables(folder, "ego"), ["dhw_mean"]))
    assert next(line for line in shown if "CHARMS" in line).split() == ["CHARMS", "–"]


@pytest.mark.parametrize(
    ("columns", "chosen"), [(["dhw_mean", "gone"], ["dhw_mean"]), ([], ["speed_mean"])]
)
def test_the_suites_columns_are_shown_or_what_the_paper_reports(
    folder: Path, columns: list[str], chosen: list[str]
) -> None:
    assert chosen_metrics(stored_tables(folder, "ego"), columns) == chosen


def test_pairs_stand_under_their_first_ego_with_a_star_where_they_differ() -> None:
    rows = [
        ("a", "b", "speed_mean", 2.0, 1.5, 2.5, 0.0, True),
        ("a", "c", "speed_mean", -0.5, -1.0, 0.1, 1.0, False),
        ("b", "c", "speed_mean", -2.5, -3.0, -2.0, 0.0, True),
    ]
    pairs = pl.DataFrame(rows, schema=PAIRS_SCHEMA, orient="row")
    long = pl.DataFrame(schema=LONG_SCHEMA)
    shown = [line.split() for line in lines(render({"": long, "-pairs": pairs}, [], 80))]
    assert ["a", "less"] in shown
    assert ["b", "+2.000*", "+1.500,", "+2.500"] in [words[:4] for words in shown]
    assert ["c", "-0.500", "-1.000,", "+0.100"] in [words[:4] for words in shown]


@pytest.mark.parametrize("width", [20, 60, 200])
def test_no_width_breaks_it(folder: Path, width: int) -> None:
    shown = lines(render(stored_tables(folder, "ego"), [], width), width)
    assert max(map(len, shown)) <= width


def test_a_run_without_tables_is_told_what_writes_them(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match=r"ego\.csv: no such file.*charms-bench rescore"):
        stored_tables(tmp_path, "ego")


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
    with pytest.raises(RunFolderError, match=message) as refused:
        read_table(path, LONG_SCHEMA)
    assert str(path) in str(refused.value)


def test_a_number_that_is_not_finite_is_none(tmp_path: Path) -> None:
    path = tmp_path / "ego.csv"
    path.write_text(EGO.replace("24.0,23.5", "inf,nan"))
    assert read_table(path, LONG_SCHEMA).row(0)[4:6] == (None, None)


STAGES = """\
stage,style,steps,wall_s,steps_per_s,return,crashed,agreement_before,agreement
first,"safe, egoistic",1000,90.0,1200.0,39.5,0.25,,
imitation,imitation,,6.0,,,,0.253,0.448
"""
CURVES = """\
stage,steps,return_mean,crashed_share,epoch,agreement
first,500,10.0,1.0,,
first,1000,40.0,0.25,,
imitation,,,,0,0.253
imitation,,,,1,0.448
"""


def test_a_training_shows_its_stages_and_curves(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").write_text(STAGES)
    (tmp_path / "curves.csv").write_text(CURVES)
    shown = [line.split() for line in lines(training.render(training.stored_training(tmp_path)))]
    assert ["first", "1.5", "min", "1,200", "39.5", "25%"] in shown
    assert ["imitation", "0.1", "min", "25.3%", "→", "44.8%"] in shown
    assert ["first", "10", "▃█", "40"] in shown
    assert ["first", "1", "█▃", "0.25"] in shown
    assert ["imitation", "0.253", "▁█", "0.448"] in shown


def test_a_stage_that_would_move_the_cursor_is_refused(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").write_text(STAGES.replace("imitation", "\x1b[2J"))
    with pytest.raises(RunFolderError, match="has control characters"):
        training.stored_training(tmp_path)


def test_a_table_that_never_ends_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").symlink_to("/dev/zero")
    with pytest.raises(RunFolderError, match="is a pipe or a device, not a file"):
        training.stored_training(tmp_path)


def test_a_table_of_no_stages_is_refused(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").write_text("name\nfirst\n")
    with pytest.raises(RunFolderError, match="expected a column 'stage', found name"):
        training.stored_training(tmp_path)
