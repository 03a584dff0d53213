"""Tables as a terminal shows them, drawn to scale."""

import io
from collections.abc import Callable

import polars as pl
import pytest
from ego_table import EGO, SUITE
from handmade_cells import lines
from rich.console import Group

from charms_bench.report.number import Number
from charms_bench.report.pairs_table import KEYS, LONG
from charms_bench.report.pairs_table import from_frame as pairs_from_frame
from charms_bench.report.suite_table import from_frame, printed
from charms_bench.report.table import Column, Row, Table, long_schema
from charms_bench.report.terminal import compact, drawn, grid

TABLE = from_frame(pl.read_csv(io.StringIO(EGO)), SUITE)


def test_every_value_has_its_interval_as_numbers_and_as_a_bar() -> None:
    shown = lines(drawn(TABLE.select("speed_mean"), 70), width=70)
    assert shown[1:5] == [
        "Metrics of the paper",
        "Mean speed near a leader                 m/s  23.5           31  paper",
        "  IDM                     24.00  23.50–24.50  ━●━                 24.2",
        "  CHARMS                  30.00  29.00–31.00              ━━●━━",
    ]


def test_units_are_those_of_the_set_whatever_its_thresholds() -> None:
    shown = lines(drawn(TABLE))
    place = shown.index("Standard metrics (ttc_s=2)")
    assert shown[place + 1].split()[:3] == ["Mean", "speed", "m/s"]


def test_columns_that_do_not_fit_are_named_apart_though_names_have_commas() -> None:
    columns = tuple(Column(name, label=name) for name in ("Speed, std", "Yaw, std", "Jerk, RMS"))
    table = Table("t", "", ("ego",), columns, (Row(("a",), (Number(1.0),) * 3),))
    assert lines(compact(table, 12))[-1] == "More columns: Yaw, std; Jerk, RMS."


def test_what_is_not_defined_is_a_dash_without_a_bar() -> None:
    shown = lines(drawn(TABLE.select("dhw_mean"), 80))
    assert next(line for line in shown if "CHARMS" in line).split() == ["CHARMS", "–"]


@pytest.mark.parametrize(
    ("columns", "chosen"), [(["dhw_mean", "gone"], ["dhw_mean"]), ([], ["speed_mean"])]
)
def test_the_suites_columns_are_shown_or_what_the_paper_reports(
    columns: list[str], chosen: list[str]
) -> None:
    names = dict.fromkeys(column.name for column in printed(TABLE, columns).columns)
    assert list(names) == chosen


def test_pairs_stand_under_their_first_ego_with_a_star_where_they_differ() -> None:
    rows = [
        ("a", "b", "speed_mean", 2.0, 1.5, 2.5, 0.0, True),
        ("a", "c", "speed_mean", -0.5, -1.0, 0.1, 1.0, False),
        ("b", "c", "speed_mean", -2.5, -3.0, -2.0, 0.0, True),
    ]
    pairs = pl.DataFrame(rows, schema=long_schema(KEYS, LONG), orient="row")
    shown = [line.split() for line in lines(drawn(pairs_from_frame(pairs, SUITE)), 100)]
    assert ["a"] in shown
    assert ["b", "+2.00*", "+1.50,", "+2.50"] in [words[:4] for words in shown]
    assert ["c", "-0.50", "-1.00,", "+0.10"] in [words[:4] for words in shown]
    assert "second indented under first" in " ".join(map(" ".join, shown))


def test_the_sign_of_a_difference_is_explained_even_if_none_is_marked() -> None:
    rows = [("a", "b", "speed_mean", 0.1, -1.0, 1.2, 1.0, False)]
    pairs = pl.DataFrame(rows, schema=long_schema(KEYS, LONG), orient="row")
    shown = lines(drawn(pairs_from_frame(pairs, SUITE)))
    assert any("First minus second." in line and "*:" not in line for line in shown)


@pytest.mark.parametrize("stacked", [True, False])
def test_long_labels_are_wrapped_and_no_number_is_cut_off(stacked: bool) -> None:
    label = "".join(chr(ord("A") + k % 26) for k in range(80))
    number = Number(0.0222, 0.0130, 0.0329)
    columns = tuple(Column(f"traffic_crashes_per_1000km_{k}") for k in range(2))
    table = Table("t", "", ("agent", "traffic"), columns, (Row((label, label), (number,) * 2),))
    shown = lines(grid(table, 80, stacked))
    assert max(map(len, shown)) <= 80
    assert sum(line.count("A") for line in shown) == 2 * label.count("A")
    assert sum(line.count("0.0222") for line in shown) == 2
    assert sum(line.count("0.0329") for line in shown) == 2


@pytest.mark.parametrize(("view", "width"), [(compact, 90), (grid, 90)])
def test_no_name_breaks_within_a_word_where_a_column_of_numbers_fits_beside(
    view: Callable[..., Group], width: int
) -> None:
    names = ("charms-roads-safe-prosocial", "roundabout-generic-v1", "yielding_human")
    row = Row(names, (Number(0.1, 0.05, 0.2),) * 3)
    columns = tuple(Column(f"column {k}") for k in range(3))
    shown = lines(view(Table("t", "", ("agent", "road", "traffic"), columns, (row,)), width), width)
    assert all(any(name in line for line in shown) for name in names)
    assert any("0.050–0.200" in line for line in shown)


def test_labels_that_fit_stay_on_one_line_with_every_column_beside_them() -> None:
    row = Row(("Imitation Learning",), (Number(0.0222, 0.0130, 0.0329),) * 13)
    columns = tuple(Column(f"traffic_crashes_per_1000km_{k}") for k in range(13))
    shown = lines(grid(Table("t", "", ("agent",), columns, (row,)), 120), 120)
    assert sum(line.count("0.0130–0.0329") for line in shown) == 13
    assert any("Imitation Learning" in line for line in shown)


@pytest.mark.parametrize("width", [20, 60, 200])
def test_no_width_breaks_it(width: int) -> None:
    shown = lines(drawn(TABLE, width), width)
    assert max(map(len, shown)) <= width
