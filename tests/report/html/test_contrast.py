"""Every text of a figure in a page stands out from what is behind it, in light and in dark.

Colours are read from the SVG and the page's style sheet. The limit is that of WCAG 2.2 for text,
success criterion 1.4.3.
"""

import re
from importlib.resources import files
from xml.etree import ElementTree

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import contrast
from charms_bench.report.figures.heat_map import draw_matrices
from charms_bench.report.figures.styles import draw_separations
from charms_bench.report.figures.tradeoff import OF_EGOS, draw_tradeoff
from charms_bench.report.html.svg import in_page
from charms_bench.report.number import Number
from charms_bench.report.suite_table import KEYS, LONG, from_frame
from charms_bench.report.table import Column, Row, Table, long_schema
from charms_bench.runs.suite import Suite

SUITE = Suite.model_validate(
    {"suite": "s", "episodes": 1, "egos": [{"agent": "a"}], "traffic_models": [{"traffic": "t"}]}
)
MODES = ("light", "dark")
ENOUGH = 4.5


def rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def over(colour: str, opacity: float, behind: str) -> str:
    """A colour drawn over another one."""
    pairs = zip(rgb(colour), rgb(behind), strict=True)
    return "#" + "".join(f"{round(opacity * a + (1 - opacity) * b):02x}" for a, b in pairs)


def in_mode(colour: str, mode: str) -> str:
    """A colour of a figure as the style sheet shows it in a mode."""
    css = (files("charms_bench.report.html") / "templates" / "page.css").read_text()
    name = {"currentColor": "ink", "var(--card)": "card"}.get(colour)
    if name is None:
        return colour
    tones = re.search(rf"--{name}: light-dark\((#\w+), (#\w+)\)", css)
    assert tones, name
    return tones[1 + MODES.index(mode)]


def style(element: ElementTree.Element) -> dict[str, str]:
    pairs = (each.split(":", 1) for each in element.get("style", "").split(";") if ":" in each)
    return {name.strip(): value.strip() for name, value in pairs}


def fields_and_texts(figure: Figure) -> list[tuple[str, str, float, np.ndarray]]:
    """Filled paths and texts in the order in which they are drawn: text, fill, opacity, points."""
    svg = in_page(figure, "figure", "a figure").replace("xlink:href", "href")
    found = []
    for element in ElementTree.fromstring(svg).iter():
        look = style(element)
        kind = element.tag.rpartition("}")[2]
        # Matplotlib leaves black out, which the style sheet changes for text.
        fill = look.get("fill", "currentColor" if kind == "text" else "#000000")
        if kind == "text":
            moved = re.findall(r"translate\(([\d.]+) ([\d.]+)\)", element.get("transform", ""))
            x, y = map(float, moved[0] if moved else (element.attrib["x"], element.attrib["y"]))
            found.append((element.text or "", fill, 1.0, np.array([[x, y - 2.0]])))
        elif kind == "path" and fill != "none":
            corners = re.findall(r"(-?[\d.]+) (-?[\d.]+)", element.get("d", ""))
            points = np.array(corners, dtype=float)
            found.append(("", fill, float(look.get("opacity", 1)), points))
    return found


def contrasts(figure: Figure, mode: str) -> dict[str, float]:
    """The contrast of each text with what is drawn behind it."""
    drawn = fields_and_texts(figure)
    found = {}
    for k, (text, fill, _, (place, *_)) in enumerate(drawn):
        if text:
            behind = in_mode("var(--card)", mode)
            for other, colour, opacity, points in drawn[:k]:
                inside = (points.min(axis=0) <= place) & (place <= points.max(axis=0))
                if not other and inside.all():
                    behind = over(in_mode(colour, mode), opacity, behind)
            found[text] = contrast(in_mode(fill, mode), behind)
    return found


def cells(*names: tuple[str, str]) -> Table:
    rows = [
        (agent, traffic, "standard-2", metric, value, value, value, 10, None)
        for k, (agent, traffic) in enumerate(names)
        for metric, value in (("speed_mean", 25.0 + k), ("crashed_episodes", 0.01 + 0.01 * k))
    ]
    return from_frame(pl.DataFrame(rows, long_schema(KEYS, LONG), orient="row"), SUITE)


def matrix(metric: str) -> Table:
    columns = tuple(Column(f"traffic {k}", form=".1f") for k in range(20))
    return Table(
        f"m-{metric}", "t", ("ego",), columns, (Row(("a",), tuple(map(Number, range(20)))),)
    )


def test_white_on_black_has_the_ratio_that_wcag_gives() -> None:
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)
    assert over("#ffffff", 0.7, "#171c24") == "#b9bbbd"


@pytest.mark.parametrize("mode", MODES)
def test_names_of_points_can_be_read(mode: str) -> None:
    found = contrasts(draw_tradeoff(cells(("A", "calm"), ("B", "calm")), OF_EGOS), mode)
    assert {"A", "B", "mean speed, m/s"} <= set(found)
    assert min(found.values()) >= ENOUGH
    found = contrasts(draw_tradeoff(cells(("A", "calm"), ("B", "busy")), OF_EGOS), mode)
    assert {"1", "2", "calm"} <= set(found)
    assert min(found.values()) >= ENOUGH


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("metric", ["speed_mean", "crashed_episodes", "conflicts_per_1000km"])
def test_numbers_in_coloured_fields_can_be_read(mode: str, metric: str) -> None:
    found = contrasts(draw_matrices([matrix(metric)]), mode)
    assert {f"{k}.0" for k in range(20)} <= set(found)
    assert min(found.values()) >= ENOUGH


@pytest.mark.parametrize("mode", MODES)
def test_the_counts_of_separated_pairs_can_be_read(mode: str) -> None:
    names = [("a", "b"), ("a", "c"), ("b", "c")]
    numbers = [[Number(1.0, marked=k < count) for k in range(4)] for count in (0, 2, 4)]
    rows = tuple(Row(pair, tuple(each)) for pair, each in zip(names, numbers, strict=True))
    columns = tuple(Column(name) for name in "wxyz")
    found = contrasts(draw_separations(Table("p", "t", ("first", "second"), columns, rows)), mode)
    assert {"0", "2", "4"} <= set(found)
    assert min(found.values()) >= ENOUGH
