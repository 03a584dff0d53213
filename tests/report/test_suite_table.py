"""The table of a suite, and its views for a terminal and as Markdown."""

from pathlib import Path

import polars as pl
import pytest
from ego_table import SUITE
from handmade_cells import cell_of, lines

from charms_bench.metrics import PAPER, STANDARD
from charms_bench.report.markdown import document
from charms_bench.report.run_files import write_table
from charms_bench.report.stored import stored_tables
from charms_bench.report.suite_table import from_frame, part_of, printed, time_over
from charms_bench.report.table import Table
from charms_bench.report.terminal import grid
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite


def cell(
    speeds: list[float],
    agent: str = "IDM+MOBIL",
    traffic: str = "mixed",
    leader: float | None = 30.0,
    paper: dict[str, float] | None = None,
) -> CellRows:
    """An episode a speed, of one step each."""
    step = {"step": 1, "acceleration": 0.5, "steering": 0.0, "lane": 0, "vehicles_near": 2}
    step |= dict.fromkeys(("length", "leader_length"), 5.0)
    front = {} if leader is None else {"leader_distance": leader, "leader_speed": 25.0}
    head = {"ending": "time", "steps": 1, "duration_s": 1 / 3, "distance_m": 10.0}
    others = {"traffic_vehicles": 20, "traffic_crashed": 0, "traffic_distance_m": 200.0}
    rows = [{"episode": e, "speed": speed, **step, **front} for e, speed in enumerate(speeds)]
    heads = [{"episode": e, **head, **others} for e in range(len(speeds))]
    return cell_of(agent, heads, rows, traffic, paper=paper or {})


def suite_table(suite: Suite, cells: list[CellRows]) -> Table:
    parts = pl.concat(part_of(suite, each, suite.metric_sets) for each in cells)
    return from_frame(parts, suite, suite.metric_sets)


def row(table: Table, metric: str, metric_set: str = PAPER.label) -> dict[str, object]:
    return table.frame().row(
        by_predicate=pl.col("metric").eq(metric) & (pl.col("metric_set") == metric_set), named=True
    )


def shown(table: Table, columns: tuple[str, ...] = ()) -> str:
    return "\n".join(lines(grid(printed(table, columns)), 100))


def test_the_long_table_has_a_row_for_every_metric_of_every_cell() -> None:
    table = suite_table(SUITE, [cell([24.0, 26.0]), cell([20.0], agent="other")])
    header = ["agent", "traffic", "metric_set", "metric", "value", "low", "high", "n", "paper"]
    frame = table.frame()
    assert frame.columns == header
    assert len(frame) == 2 * (len(PAPER.metrics) + len(STANDARD.metrics))
    assert frame["metric_set"].unique(maintain_order=True).to_list() == ["paper-2", "standard-5"]


def test_a_row_has_value_interval_number_and_the_papers_figure() -> None:
    table = suite_table(SUITE, [cell([24.0, 26.0], paper={"speed_mean": 23.67})])
    assert row(table, "speed_mean") == {
        "agent": "IDM+MOBIL",
        "traffic": "mixed",
        "metric_set": "paper-2",
        "metric": "speed_mean",
        "value": 25.0,
        "low": 24.0,  # a quarter of the resamples has one episode twice
        "high": 26.0,
        "n": 2,
        "paper": 23.67,
    }
    assert row(table, "speed_mean", STANDARD.label)["paper"] is None


def test_what_is_not_defined_is_null() -> None:
    table = suite_table(SUITE, [cell([25.0], leader=None)])
    undefined = row(table, "speed_mean")
    assert (undefined["value"], undefined["low"], undefined["high"]) == (None, None, None)
    assert undefined["n"] == 0
    assert row(table, "crashed_episodes", STANDARD.label)["value"] == 0.0


def test_a_cells_numbers_do_not_depend_on_the_cells_beside_it() -> None:
    first, second = cell([20.0, 25.0, 31.0]), cell([22.0] * 9, agent="other")
    both = suite_table(SUITE, [second, first])
    assert both.rows[1:] == suite_table(SUITE, [first]).rows


def test_tables_are_written_the_same_every_time(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        cells = [cell([20.0, 25.0, 31.0], paper={"speed_mean": 25.0}), cell([20.0], agent="b")]
        write_table(tmp_path / folder, suite_table(SUITE, cells))
    one, two = tmp_path / "one" / "tables", tmp_path / "two" / "tables"
    for name in ("SHA256SUMS", "ego.csv", "ego.md"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
    assert sorted(path.name for path in one.iterdir()) == ["SHA256SUMS", "ego.csv", "ego.md"]


def test_markdown_shows_the_interval_the_papers_figure_and_the_difference() -> None:
    cells = [
        cell([24.0, 26.0], paper={"speed_mean": 23.67}),
        cell([25.0], agent="none", leader=None, paper={"speed_mean": 23.73}),
    ]
    text = document(suite_table(SUITE, cells))
    assert "| 25.00 [24.00, 26.00] | 23.67 (+1.33) |" in text
    assert "| – | 23.73 |" in text
    assert (
        "- Mean speed near a leader (m/s) (`speed_mean`): speed with a leader within 50 m. n: "
        "decisions near a leader."
    ) in text


def test_the_terminal_shows_the_columns_of_the_suite_in_100_characters() -> None:
    cells = [
        cell([24.0, 26.5, 33.0], agent=agent, paper={"speed_mean": 28.892})
        for agent in ("Efficient-Competitive", "Efficient-Egoistic")
    ]
    columns = (*(metric.name for metric in PAPER.metrics), "crashed_episodes")
    text = shown(suite_table(SUITE, cells), columns)
    assert max(map(len, text.splitlines())) <= 100
    assert "…" not in text
    assert "paper 28.892" in text
    assert "Crashed episodes" in " ".join(text.split())
    assert "tet" not in text


def test_without_columns_and_paper_the_terminal_shows_every_metric() -> None:
    text = " ".join(shown(suite_table(SUITE, [cell([25.0])])).lower().split())
    for metric in ("interaction", "jerk", "tet", "drac"):
        assert metric in text


@pytest.mark.parametrize(
    ("names", "headers"),
    [
        ([("a", "x"), ("b", "x")], ("agent",)),
        ([("a", "x"), ("a", "y")], ("traffic",)),
        ([("a", "x"), ("b", "y")], ("agent", "traffic")),
        ([("a", "x")], ("agent",)),
    ],
)
def test_the_terminal_names_what_differs(
    names: list[tuple[str, str]], headers: tuple[str, ...]
) -> None:
    cells = [cell([25.0], agent=agent, traffic=traffic) for agent, traffic in names]
    words = shown(suite_table(SUITE, cells), ("speed_mean",)).split()
    assert tuple(word for word in ("agent", "traffic") if word in words) == headers


def test_a_sentence_says_how_many_episodes_end_by_time() -> None:
    names = ["agent", "road", "traffic", "metric_set", "metric", "value"]
    proportions = {"slow": (0.5, 0.1), "quick": (0.9, 0.1), "without a goal": (None, 0.2)}
    rows = [
        (agent, "exit-v1", "human", f"{kind}-1", metric, value)
        for agent, (goal, crashed) in proportions.items()
        for kind, metric, value in (
            ("roads", "goal_reached", goal),
            ("standard", "crashed_episodes", crashed),
        )
    ]
    frame = pl.DataFrame(rows, schema=names, orient="row")
    assert "time was over: at most 40.0 % (slow in exit-v1 in human)" in time_over(frame)
    assert time_over(frame.filter(agent="quick")) == ""
    assert time_over(frame.filter(agent="without a goal")) == ""


def test_headings_break_between_words_only() -> None:
    forms = {"preventable collisions": ".0f", "abandoned changes": ".0f", "what happened": ""}
    long = dict.fromkeys(("agent", "road", "what happened"), "intersection-multi-agent-v1")
    record = {**dict.fromkeys(forms, 1.0), **long}
    shown = lines(grid(Table.plain([record], ("agent", "road"), forms), 40), 40)
    headings = {"preventable", "collisions", "abandoned", "changes", "what", "happened"}
    assert headings <= {*" ".join(shown).split()}


def test_the_note_of_a_suite_stands_under_its_table_and_in_its_document() -> None:
    suite = SUITE.model_copy(update={"note": "IDM+MOBIL was calibrated."})
    table = suite_table(suite, [cell([25.0])])
    assert shown(table).rstrip().endswith("IDM+MOBIL was calibrated.")
    assert "\n\nIDM+MOBIL was calibrated.\n\n" in document(table)


def test_markdown_shows_tags_and_links_of_a_name_as_text() -> None:
    name = r"<img src=x onerror=alert(1)> [a](javascript:b) c\|d"
    suite = SUITE.model_copy(update={"note": "<script>alert(1)</script> p < 0.05"})
    text = document(suite_table(suite, [cell([25.0], agent=name)]))
    assert r"| &lt;img src=x onerror=alert(1)> [a\](javascript:b) c\\\|d | mixed |" in text
    assert "&lt;script>alert(1)&lt;/script> p < 0.05" in text


def test_a_label_that_a_spreadsheet_would_compute_is_a_text_and_is_read_back(
    tmp_path: Path,
) -> None:
    label = '=HYPERLINK("http://x")'
    table = suite_table(SUITE, [cell([25.0], agent=label)])
    write_table(tmp_path, table)
    written = (tmp_path / "tables" / "ego.csv").read_text()
    assert written.splitlines()[1].startswith("\"'=HYPERLINK")
    assert {row.labels[0] for row in stored_tables(tmp_path, SUITE).metrics.rows} == {label}
