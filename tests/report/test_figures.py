"""Figures of many cells at once: that every cell is in them, whatever it is called."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from ego_table import SUITE
from handmade_replay import replay_of

from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.errors import InputError
from charms_bench.report.figures.drawing import save
from charms_bench.report.figures.heat_map import draw_matrices, reading
from charms_bench.report.figures.human_driving import draw_quantity
from charms_bench.report.figures.preventable import in_words
from charms_bench.report.figures.timelines import draw_timelines
from charms_bench.report.figures.tradeoff import OF_EGOS, OF_TRAFFICS, draw_tradeoff
from charms_bench.report.html.svg import in_page
from charms_bench.report.markdown import markdown
from charms_bench.report.suite_table import KEYS, LONG, from_frame, matrices
from charms_bench.report.table import Table, long_schema
from charms_bench.runs.cells import TrafficCounts
from charms_bench.world.following_bins import BINS


def table(*rows: tuple[str, str, str, float | None]) -> Table:
    made = [
        (agent, traffic, "standard-5", metric, value, value and 0.9 * value, value and 1.1 * value)
        for agent, traffic, metric, value in rows
    ]
    schema = long_schema(KEYS, LONG)
    frame = pl.DataFrame(made, schema=list(schema)[:7], orient="row").with_columns(
        n=pl.lit(10), paper=pl.lit(None)
    )
    return from_frame(frame, SUITE)


def cells(*names: tuple[str, str]) -> Table:
    rows = []
    for k, (agent, traffic) in enumerate(names):
        rows += [
            (agent, traffic, "speed_mean", 25.0 + k),
            (agent, traffic, "crashed_episodes", 0.01 * k),
            (agent, traffic, "traffic_crashed", None if k == 0 else 0.02),
        ]
    return table(*rows)


def test_every_cell_is_named_in_the_tradeoff(tmp_path: Path) -> None:
    save(
        draw_tradeoff(cells(("A & B", "calm"), ("C", "calm"), ("C", "<busy>")), OF_EGOS),
        tmp_path / "t.svg",
    )
    svg = (tmp_path / "t.svg").read_text()
    for name in ("A &amp; B", "C", "&lt;busy&gt;"):
        assert f" {name} -->" in svg


def test_letters_that_the_font_does_not_have_are_boxes_without_a_warning(tmp_path: Path) -> None:
    figure = draw_tradeoff(cells(("雪", "calm"), ("C", "calm"), ("C", "busy")), OF_EGOS)
    save(figure, tmp_path / "t.png")
    assert "雪" in in_page(figure, "t", "a figure")


def test_traffics_of_one_ego_are_named_themselves(tmp_path: Path) -> None:
    rows = [
        ("IDM", traffic, metric, value)
        for traffic, density in (("calm", 1.9), ("busy", 2.6))
        for metric, value in (("interaction_density", density), ("traffic_crashed", 0.1))
    ]
    save(draw_tradeoff(table(*rows), OF_TRAFFICS), tmp_path / "t.svg")
    svg = (tmp_path / "t.svg").read_text()
    assert "<!-- calm -->" in svg
    assert "<!-- busy -->" in svg


def test_crashes_at_fault_are_hollow_points_below_all_crashes() -> None:
    rows = [
        ("A", "calm", metric, value)
        for metric, value in (
            ("speed_mean", 25.0),
            ("crashed_episodes", 0.3),
            ("crashed_at_fault", 0.1),
        )
    ]
    (axes,) = draw_tradeoff(table(*rows), OF_EGOS).axes
    hollow = [line for line in axes.lines if line.get_markerfacecolor() == "none"]
    assert [tuple(*line.get_xydata()) for line in hollow] == [(25.0, 0.1)]


def test_a_long_list_of_names_is_beside_the_points_and_above_the_legend() -> None:
    names = [(f"ego {k}", traffic) for k in range(40) for traffic in ("calm", "busy")]
    figure = draw_tradeoff(cells(*names), OF_EGOS)
    (axes,) = figure.axes
    (listed,) = (text for text in axes.texts if "ego 39" in text.get_text())
    box, legend = listed.get_window_extent(), axes.get_legend()
    assert legend is not None
    assert figure.bbox.contains(box.x0, box.y0)
    assert box.y0 > legend.get_window_extent().y1
    assert axes.get_window_extent().height > 0.7 * figure.bbox.height


def test_drivers_at_the_same_place_keep_their_names_apart(tmp_path: Path) -> None:
    same = [(name, "calm", m, 0.01) for name in "AB" for m in ("speed_mean", "crashed_episodes")]
    save(draw_tradeoff(table(*same), OF_EGOS), tmp_path / "t.svg")
    assert (tmp_path / "t.svg").exists()


def test_a_matrix_has_egos_down_and_traffics_across(tmp_path: Path) -> None:
    pairs = [(ego, traffic) for ego in ("A", "B|C") for traffic in ("calm", "busy")]
    found = matrices(cells(*pairs))
    text = "".join(map(markdown, found))
    assert "| ego \\ traffic model | calm | busy |" in text
    assert "| A | 0.0 [0.0, 0.0] | 1.0 [0.9, 1.1] |" in text
    assert "| B\\|C | 2.0 [1.8, 2.2] | 3.0 [2.7, 3.3] |" in text
    assert "| A | 25.0 [22.5, 27.5] | 26.0 [23.4, 28.6] |" in text
    assert "| A | – | 2.0 [1.8, 2.2] |" in text  # nothing is known of the traffic's crashes
    save(draw_matrices(found), tmp_path / "m.svg")
    svg = (tmp_path / "m.svg").read_text()
    assert all(f"<!-- {name} -->" in svg for name in ("B|C", "busy", "28.0", "3.0"))


def test_a_darker_field_is_higher_and_equal_proportions_are_equally_dark() -> None:
    names = ("crashed_episodes", "traffic_crashed", "speed_mean", "conflicts_per_1000km")
    rows = {"A": (0.5, 0.25, 25.0, 900.0), "B": (0.1, 0.5, 20.0, 1_900.0)}
    of_busy = {"A": (0.25, 0.1, 33.0, 0.0), "B": (0.2, 0.2, 30.0, 0.0)}
    found = matrices(
        table(
            *((ego, "calm", *each) for ego in rows for each in zip(names, rows[ego], strict=True)),
            *((e, "busy", *each) for e in rows for each in zip(names, of_busy[e], strict=True)),
        )
    )
    light: dict[str, dict[float, float]] = {}
    for axes, matrix in zip(draw_matrices(found).axes, found, strict=True):
        (mesh,) = axes.collections
        values = mesh.get_array()
        tones = mesh.to_rgba(values)[..., :3].sum(axis=-1)
        light[matrix.name] = dict(zip(values.flat, tones.flat, strict=True))
    crashed, traffic, speed = (light[f"ego-{name}"] for name in names[:3])
    assert crashed[50.0] < crashed[25.0] < crashed[10.0]
    assert all(traffic[each] == crashed[each] for each in (10.0, 20.0, 25.0, 50.0))
    assert speed[33.0] < speed[25.0] < speed[20.0]
    assert "1,900.0" in "".join(map(markdown, found))
    worse = {each.name for each in found if "worse: higher" in reading(each)}
    assert worse == {f"ego-{name}" for name in names if name != "speed_mean"}


def test_the_timelines_of_two_futures_share_their_axes_up_to_the_later_end() -> None:
    def future(frames: int, speed: float) -> Replay:
        x = np.array([0.0, 30.0]) + np.arange(frames)[:, None]
        return replay_of(x=x, y=4.0, speed=np.tile([speed, 20.0], (frames, 1)))

    recorded, other = future(31, 25.0), future(61, 22.0)
    _, _, speed, _ = draw_timelines(recorded, ego_view(recorded), other).axes
    assert speed.get_xlim() == (0.0, 4.0)
    assert sorted(line.get_ydata()[0] for line in speed.lines) == [22.0, 25.0]


def test_one_ego_or_one_traffic_needs_no_matrix() -> None:
    assert matrices(cells(("A", "calm"), ("A", "busy"))) == []


def test_a_figure_of_an_unknown_kind_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a name that ends in \.pdf, \.png, \.svg"):
        save(draw_tradeoff(cells(("A", "calm")), OF_EGOS), tmp_path / "t.jpeg")


@pytest.mark.parametrize(
    ("parameter", "expected"),
    [
        ("gap_m", "gap, m"),
        ("braking_mps2", "braking, m/s²"),
        ("side_gap", "side gap"),
        ("s", "s"),
    ],
)
def test_an_axis_has_the_parameter_in_words_and_its_unit(parameter: str, expected: str) -> None:
    assert in_words(parameter) == expected


def test_human_drivers_are_drawn_beside_every_traffic(tmp_path: Path) -> None:
    counts = np.ones((3, 2, BINS))
    traffics = [TrafficCounts("one", counts), TrafficCounts("other", counts)]
    save(draw_quantity("speed", traffics, {"i24": counts[0, 0]}), tmp_path / "s.svg")
    svg = (tmp_path / "s.svg").read_text()
    assert all(f"<!-- {name} -->" in svg for name in ("human drivers", "one", "other"))
