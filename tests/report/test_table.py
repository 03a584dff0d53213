"""The table model: what a table holds, and how its numbers are written."""

import math
from dataclasses import replace

import pytest

from charms_bench.errors import InputError
from charms_bench.report.formatting import write_column
from charms_bench.report.number import Number
from charms_bench.report.table import Column, Row, Table

SPEED = Column("speed_mean", "m/s", "speed in logged steps", "logged steps", group="paper-2")
CRASHED = Column("crashed_episodes", group="standard-5")
TABLE = Table(
    name="ego",
    title="Egos",
    keys=("agent", "traffic"),
    columns=(SPEED, CRASHED),
    rows=(
        Row(("IDM", "mixed"), (Number(23.676, 23.5, 23.8, 100, reference=23.67), Number(0.0, n=9))),
        Row(("A|<b>", "mixed"), (Number(), Number(0.5, 0.25, 0.75, 9, marked=True))),
    ),
    reference="paper",
)


def test_the_frame_has_one_number_per_row() -> None:
    frame = TABLE.frame()
    assert frame.columns[:4] == ["agent", "traffic", "group", "name"]
    assert frame.row(0) == (
        "IDM", "mixed", "paper-2", "speed_mean", 23.676, 23.5, 23.8, 100, 23.67, None, False
    )  # fmt: skip
    assert frame["value"].to_list() == [23.676, 0.0, None, 0.5]


def test_a_frame_gives_the_table_back() -> None:
    columns = {(column.group, column.name): column for column in TABLE.columns}
    again = Table.from_frame(
        TABLE.frame(), "ego", "Egos", TABLE.keys, TABLE.long,
        lambda group, name: columns[group, name], reference="paper",
    )  # fmt: skip
    assert again == TABLE


def test_a_frame_lists_quantity_by_quantity() -> None:
    columns = tuple(replace(column, quantity=column.name) for column in TABLE.columns)
    rows = (Row(("a",), (Number(1.0), Number(2.0))), Row(("b",), (Number(3.0), Number(4.0))))
    by_part = Table("t", "", ("agent",), columns, rows)
    assert by_part.frame()["value"].to_list() == [1.0, 3.0, 2.0, 4.0]


def test_metrics_are_selected_in_the_order_asked_for_within_their_groups() -> None:
    both = Table("t", "", (), (CRASHED, SPEED, Column("acc_std", group="paper-2")), ())
    chosen = both.select("acc_std", "speed_mean", "crashed_episodes")
    assert [each.name for each in chosen.columns] == ["crashed_episodes", "acc_std", "speed_mean"]
    with pytest.raises(InputError, match=r"no metric named 'speed'\..*Did you mean 'speed_mean'"):
        TABLE.select("speed")


def test_each_group_is_a_part_with_its_name_as_title() -> None:
    assert [part.title for part in TABLE.parts()] == ["Metrics of the paper", "Standard metrics"]
    assert [len(part.columns) for part in TABLE.parts()] == [1, 1]


def test_keys_that_do_not_differ_can_be_left_out() -> None:
    shorter = TABLE.without_constant_keys()
    assert shorter.keys == ("agent",)
    assert [row.labels for row in shorter.rows] == [("IDM",), ("A|<b>",)]


def test_records_become_rows_of_numbers_and_texts() -> None:
    columns = (Column("criticality"), Column("what"))
    table = Table.from_records(
        [{"rank": 1, "criticality": 0.98, "what": "rear-end"}], "t", "", ("rank",), columns
    )
    assert table.rows == (Row(("1",), (Number(0.98), "rear-end")),)


def test_a_notebook_shows_names_as_text_and_numbers_with_intervals() -> None:
    page = TABLE._repr_html_()
    assert "A|&lt;b&gt;" in page
    assert "23.50–23.80" in page
    assert 'title="speed in logged steps"' in page
    assert "href" not in page


@pytest.mark.parametrize(
    ("form", "signed", "number", "expected"),
    [
        ("", False, Number(23.676, 23.5, 123.8), ("23.7", "23.5", "123.8")),
        ("", False, Number(0.0301, 0.023, 0.0391), ("0.0301", "0.0230", "0.0391")),
        ("", False, Number(12345.6), ("12,346", "", "")),
        (".1%", False, Number(0.0301, 0.023, 0.0391), ("3.0 %", "2.3", "3.9")),
        ("margin", True, Number(-0.678, -0.826, -0.531), ("-0.68", "-0.83", "-0.53")),
        ("margin", True, Number(0.0, None, None), ("+0", "", "")),
        ("margin", True, Number(-1234.5, None, None), ("-1234", "", "")),
        ("p", False, Number(0.0001), ("<0.001", "", "")),
        ("p", False, Number(0.04), ("0.040", "", "")),
        ("", False, Number(), ("–", "", "")),
    ],
)
def test_a_number_is_written_with_the_digits_of_its_column(
    form: str, signed: bool, number: Number, expected: tuple[str, str, str]
) -> None:
    (written,) = write_column(Column("x", form=form, signed=signed), [number])
    assert (written.value, written.low, written.high) == expected


@pytest.mark.parametrize(
    ("form", "expected"),
    [
        ("", "∞ 2.000 ∞ -∞"),
        (".1%", "∞ % 200.0 ∞ -∞ %"),
        ("margin", "∞ 2 ∞ -∞"),
        (".2f", "∞ 2.00 ∞ -∞"),
    ],
)
def test_infinity_is_written_as_its_symbol(form: str, expected: str) -> None:
    numbers = [Number(math.inf, 2.0, math.inf), Number(-math.inf), Number(2.0)]
    first, second, _ = write_column(Column("ratio", form=form), numbers)
    assert " ".join((first.value, first.low, first.high, second.value)) == expected


def test_nan_is_written_as_nothing() -> None:
    (cell,) = write_column(Column("ratio"), [Number(math.nan, math.nan, math.nan)])
    assert (cell.value, cell.low, cell.high) == ("–", "", "")


def test_a_reference_has_its_difference_beside_it() -> None:
    (written,) = write_column(SPEED, [Number(23.676, reference=23.0)])
    assert (written.reference, written.difference) == ("23", "+0.68")


@pytest.mark.parametrize("form", ["", ".1f", "%", ".0f", "margin", ",.2f", ".3g", ".1%"])
def test_there_is_no_minus_zero(form: str) -> None:
    cells = write_column(Column("x", form=form), [Number(-1e-9), Number(-0.0, -1e-9, 1.0)])
    signed = write_column(Column("x", form=form, signed=True), [Number(-0.0)])
    texts = [text for cell in (*cells, *signed) for text in (cell.value, cell.low) if text]
    assert [text for text in texts if text.startswith("-") and not text.strip("-0.% ,")] == []
