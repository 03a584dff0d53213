"""Intervals and curves in characters."""

import pytest

from charms_bench.report.bars import Scale, bar, line
from charms_bench.report.number import Number

TENTHS = Scale(0.0, 1.0, 11)


@pytest.mark.parametrize(
    ("numbers", "drawn"),
    [
        ((0.5, 0.3, 0.8), "   ━━●━━━  "),
        ((0.5, 0.3, 0.8, 0.1), " ◇ ━━●━━━  "),
        ((0.5, 0.3, 0.8, 0.4), "   ━◇●━━━  "),
        ((0.5, 0.5, 0.5, 0.5), "     ●     "),
        ((0.0, None, None), "●          "),
        ((None, None, None), "           "),
        ((None, None, None, 1.0), "          ◇"),
    ],
)
def test_a_value_stands_in_its_interval_beside_the_papers(
    numbers: tuple[float | None, ...], drawn: str
) -> None:
    value, low, high, *paper = numbers
    number = Number(value, low, high, reference=paper[0] if paper else None)
    assert bar(TENTHS, number).plain == drawn


def test_an_infinite_interval_reaches_the_end() -> None:
    scale = Scale.over([1.0, 0.0, float("inf")], 10)
    assert (scale.low, scale.high) == (0.0, 1.0)
    assert bar(scale, Number(0.5, 0.0, float("inf"))).plain == "━━━━●━━━━━"


def test_differences_are_drawn_around_zero() -> None:
    assert bar(Scale(-1.0, 1.0, 11), Number(0.6, 0.4, 0.8)).plain == "     ┊ ━●━ "


@pytest.mark.parametrize(
    ("numbers", "zero", "ends"),
    [
        ([23.6, 32.2, None], False, (23.6, 32.2)),
        ([0.01, 0.5], False, (0.0, 0.5)),
        ([0.4, 0.5], True, (0.0, 0.5)),
        ([-2.0, -1.0], True, (-2.0, 0.0)),
        ([0.0, 0.0], False, (0.0, 1.0)),
        ([5.0, 5.0], False, (5.0, 10.0)),
        ([None], False, (0.0, 1.0)),
    ],
)
def test_a_scale_holds_all_numbers(
    numbers: list[float | None], zero: bool, ends: tuple[float, float]
) -> None:
    scale = Scale.over(numbers, 11, zero)
    assert (scale.low, scale.high) == ends


def test_a_curve_has_a_block_a_part_as_high_as_its_mean() -> None:
    assert line(Scale(0.0, 7.0, 8), [0, 1, 2, 3, 4, 5, 6, 7]) == "▁▂▃▄▅▆▇█"
    assert line(Scale(0.0, 7.0, 2), [0, 2, 6, 8]) == "▂█"
    assert line(Scale(0.0, 7.0, 8), [7.0]) == "█"
