"""Scores the likeness of all agents for docs/likeness.md, for `write_results.py likeness DATA`.

DATA is a folder that holds `i24_car_following.parquet` and `i75_lane_trajectories.parquet`. The
tool writes the tables of the page to `docs/results` and into the page, and draws its figure. If
`suites/released/networks` holds the networks of the paper's authors, they are scored, too; if not,
their table stays as it is. The agents are those of the suites, so a change of the suites or of the
networks in the package only needs another call.
"""

from pathlib import Path

from result_pages import ROOT, keep

from charms_bench.humans.population import read_population
from charms_bench.report.figures.drawing import save
from charms_bench.report.figures.likeness import draw
from charms_bench.report.likeness_table import controls_table, likeness_tables
from charms_bench.report.markdown import markdown
from charms_bench.runs.likeness import Likeness, likeness, likeness_of_controls, standard
from charms_bench.runs.suite import load_suite

SUITES = ROOT / "suites"
ROADS = {
    "i24": ("i24_car_following.parquet", SUITES / "likeness.yaml"),
    "i75": ("i75_lane_trajectories.parquet", SUITES / "likeness-all-speeds.yaml"),
}
"""The recordings of each road, and the suite that is scored against them."""
RELEASED = SUITES / "released" / "likeness.yaml"
FIGURE = ROOT / "docs" / "likeness.webp"


def write_page(data: Path) -> None:
    """Writes the tables, the page and the figure."""
    for road, (file, suite) in ROADS.items():
        read = load_suite(suite)
        against = standard(read, data / file, read_population(road))
        rows = list(likeness(read, against))
        write(f"likeness-{road}", rows)
        controls = controls_table(list(likeness_of_controls(read, against)))
        keep(f"likeness-controls-{road}", markdown(controls))
        if road == "i24":
            save(draw(rows), FIGURE)
            if (RELEASED.parent / "networks").is_dir():
                released = likeness(load_suite(RELEASED), against)
                write("likeness-released", [each for each in released if each.kind == "ego"])


def write(name: str, rows: list[Likeness]) -> None:
    """Writes the scores of some rows, and what the drivers did."""
    scores, conduct = likeness_tables(rows, [])
    keep(name, markdown(scores))
    keep(f"{name}-conduct", markdown(conduct))
