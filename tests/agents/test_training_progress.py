"""What is seen of a training while it runs."""

from io import StringIO

import pytest
from charms_agents.training.curve import Epoch, Point
from charms_agents.training.stage_progress import progress
from rich.console import Console


def test_without_a_terminal_every_tenth_of_a_stage_is_a_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress(Console(force_terminal=False)) as tell:
        tell("first", 50, 1000, "well")
        tell("first", 200, 1000, "")
        tell("first", 200, 1000, "well")
        tell("second", 300, 1000, "badly")
        tell("first", 250, 1000, "well")
    expected = "first: 200 of 1,000, well\nsecond: 300 of 1,000, badly\n"
    assert capsys.readouterr().err == expected


def test_on_a_terminal_every_stage_has_a_bar_until_it_is_done() -> None:
    screen = StringIO()
    with progress(Console(file=screen, force_terminal=True, width=120)) as tell:
        tell("first", 200, 1000, "well")
        tell("second", 1000, 1000, "")
    assert "200/1000" in screen.getvalue()
    assert "well" in screen.getvalue()


@pytest.mark.parametrize(
    ("point", "words"),
    [
        (Point(200, 10, 30.0, 50.0, 0.2, 0.0, 1.0, 0.05), "return 30.0, 20% crashed"),
        (Point(200, 0, None, None, None, None, 1.0, 0.05), ""),
        (Epoch(1, 1.5, 1.0, -1.2, 0.25), "loss 1.500, agrees with 25.0%"),
        (Epoch(1, 1.5, 1.0, None, None), "loss 1.500"),
    ],
)
def test_a_point_of_a_curve_in_words(point: Point | Epoch, words: str) -> None:
    assert point.in_words == words
