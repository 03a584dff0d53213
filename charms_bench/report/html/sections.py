"""The sections of a report, one per run: its tables and the figures that belong to them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from markupsafe import Markup
from matplotlib.figure import Figure

from charms_bench.episodes.what_if import WhatIf
from charms_bench.foundation.words import counted
from charms_bench.humans.reference import read_references
from charms_bench.report.figures.heat_map import draw_matrices, reading
from charms_bench.report.figures.human_driving import draw_quantity, recorded
from charms_bench.report.figures.learning import draw_curves
from charms_bench.report.figures.paper_values import draw_beside_paper
from charms_bench.report.figures.preventable import draw_preventable, survivors
from charms_bench.report.figures.styles import PLACED, draw_places, draw_separations
from charms_bench.report.figures.tradeoff import OF_EGOS, draw_tradeoff, tradeoff_of
from charms_bench.report.html.sources import Evaluation, Source
from charms_bench.report.html.svg import in_page
from charms_bench.report.realism_table import TITLE
from charms_bench.report.sentences import finding, place
from charms_bench.report.suite_table import matrices, one_per_metric, printed
from charms_bench.report.table import Table
from charms_bench.report.training_tables import Training
from charms_bench.report.what_if_table import what_if_table
from charms_bench.runs.suite import Suite

NARROW_INCHES = (4.2, 4.6)
"""Width and height of a figure for a phone."""
COLUMNS = 7
"""Columns of numbers in a table, so that it fits a sheet of paper."""


@dataclass(frozen=True)
class Picture:
    """A figure of a page."""

    id: str
    title: str
    caption: str
    svg: Markup
    wide: bool = False
    """Whether it needs the width of the page."""
    narrow: Markup | None = None
    """The same figure for a narrow page; without it, the figure scrolls there."""


@dataclass(frozen=True)
class Section:
    """A section of the report."""

    id: str
    title: str
    facts: Sequence[str]
    """What was run, in a few words each."""
    tables: Sequence[Table]
    pictures: Sequence[Picture]
    more: Sequence[Table] = ()
    """Tables that are folded away at first."""
    drawn_first: bool = False
    """Whether the figures stand above the tables."""
    finding: str = ""
    """What was found, in sentences."""


def section_of(source: Source, folder: Path) -> Section:
    """The section of a run folder; relative paths in a suite start at `folder`."""
    if isinstance(source, Evaluation):
        return _of_evaluation(source, folder)
    table, facts = source.found, [f"run folder {source.path.name}"]
    if isinstance(table, Training):
        return _of_training(source.key, table, facts)
    if not table.rows:
        return Section(f"run-{source.key}", table.title, [*facts, table.note], [], [])
    return Section(f"run-{source.key}", table.title, facts, [table], [])


def _of_evaluation(source: Evaluation, folder: Path) -> Section:
    suite, tables = source.run.suite, source.tables
    scene, last = suite.scene, suite.seed + suite.episodes - 1
    chosen = one_per_metric(printed(tables.metrics, suite.columns))
    order = {name: place for place, name in enumerate(suite.columns)}
    parts = sorted(
        chosen.parts(),
        key=lambda part: min(order.get(column.name, len(order)) for column in part.columns),
    )
    shown = [block for part in parts for block in part.blocks(COLUMNS + 1)]
    if tables.preventable is not None:
        shown.append(tables.preventable)
    if tables.realism is not None:
        first, *rest = tables.realism.parts()
        # The note is about all of them.
        shown = [first, *(replace(each, note="") for each in rest), *shown]
    parts = tables.metrics.without_constant_keys().parts()
    more = [block for part in parts for block in part.blocks(COLUMNS)]
    more += [] if tables.pairs is None else [tables.pairs]
    if tables.drivers is not None:
        more += tables.drivers.without_constant_keys().blocks(COLUMNS)
    where = f"{counted(len(suite.egos), 'ego')} in {counted(len(suite.surroundings), place(suite))}"
    return Section(
        id=f"run-{source.key}",
        title=suite.title or suite.suite,
        facts=(
            where,
            f"{counted(suite.episodes, 'episode')} each, seeds {suite.seed:,} to {last:,}",
            _scenes(suite),
            f"{scene.duration_s:g} s per episode",
            f"run folder {source.path.name}",
        ),
        tables=shown,
        pictures=[*_pictures(source, folder)],
        more=more,
        drawn_first=bool(matrices(tables.metrics)),
        finding=finding(suite, tables.metrics, tables.realism, source.run.cells),
    )


def _scenes(suite: Suite) -> str:
    """What the scenes of a suite look like."""
    scene = suite.scene
    if place(suite) == "scenario":
        return f"{counted(scene.lanes, 'lane')}, vehicles placed by scenarios"
    if suite.roads:
        return "highway-env's roads and vehicles"
    vehicles = counted(scene.vehicles, "vehicle")
    return f"{counted(scene.lanes, 'lane')}, {vehicles}, density {scene.density:g}"


def _of_training(key: str, training: Training, facts: Sequence[str]) -> Section:
    assert training.curves is not None
    count = training.curves["stage"].n_unique()
    caption = "A line per stage. Curves over steps were measured while the policy explored."
    return Section(
        id=f"run-{key}",
        title="Training and fine-tuning",
        facts=(counted(count, "stage"), *facts),
        tables=() if training.stages is None else training.stages.blocks(COLUMNS),
        pictures=[
            _picture(f"{key}-{k}", title, caption, figure)
            for k, (title, figure) in enumerate(draw_curves(training))
        ],
    )


def what_if_section(found: WhatIf, name: str) -> Section:
    """The section of two futures; links call it `name`."""
    recorded, table = found.recorded, what_if_table(found)
    happened, instead = found.sentences()
    facts = [recorded.cell.title, f"recorded: {happened}", f"what if: {instead}"]
    return Section(name, table.title, facts, [table], [])


def _pictures(source: Evaluation, folder: Path) -> Iterator[Picture]:
    suite, key = source.run.suite, source.key
    table, pairs = source.tables.metrics, source.tables.pairs
    if beside := draw_beside_paper(table):
        caption = (
            "Discs with 95 % intervals: this run. Diamonds: the paper. An interval that is "
            "narrower than its disc is hidden by it."
        )
        yield _picture(f"{key}-paper", "Beside the paper", caption, *beside, wide=True)
    for k, matrix in enumerate(matrices(table)):
        caption = f"Egos down, {place(suite)}s across. {reading(matrix)}"
        figure = draw_matrices([replace(matrix, title="")])
        yield _picture(f"{key}-matrix-{k}", matrix.title, caption, figure)
    tradeoff = tradeoff_of(suite)
    if len(suite.cells) > 1 and table.places(tradeoff.across, tradeoff.proportion):
        title, caption = "Density against safety", "With 95 % intervals."
        if tradeoff is OF_EGOS:
            title = "Speed against safety"
            caption += " Further right is faster, further down is safer."
        picture = _picture(
            f"{key}-tradeoff", title, caption, draw_tradeoff(table, tradeoff, (9.6, 4.4)), wide=True
        )
        small = draw_tradeoff(table, tradeoff, NARROW_INCHES, is_narrow=True)
        narrow = in_page(small, f"{key}-tradeoff-narrow", f"{title}. {caption}")
        yield replace(picture, narrow=narrow)
    if pairs is not None:
        if table.places(*PLACED):
            caption = "Mean speed and mean headway to the leader, with 95 % intervals."
            title = "Styles apart: where each stands"
            yield _picture(f"{key}-places", title, caption, draw_places(table))
        caption = (
            f"In how many of {len(pairs.columns)} metrics the two differ by more than chance "
            "(Holm-corrected p < 0.05)."
        )
        title = "Styles apart: pair by pair"
        yield _picture(f"{key}-separations", title, caption, draw_separations(pairs))
    if suite.preventable_by and (drawn := draw_preventable(suite, source.run.cells())):
        caption = f"Green: {survivors(suite)}. Points: collisions of the ego."
        yield _picture(f"{key}-preventable", "Preventable collisions", caption, drawn, wide=True)
    following = source.run.following() if suite.references else []
    references = read_references(suite.references, folder)
    caption = "Grey: human driving. Lines: traffic models."
    for quantity, title in TITLE.items():
        for k, (name, counts) in enumerate(recorded(quantity, references).items()):
            figure = draw_quantity(quantity, following, {name: counts})
            yield _picture(f"{key}-{quantity}-{k}", f"{title}: {name}", caption, figure)


def _picture(name: str, title: str, caption: str, *figures: Figure, wide: bool = False) -> Picture:
    """Figures under their title, described to screen readers by title and caption."""
    drawn = [
        in_page(figure, f"{name}-{k}", f"{title}. {caption}") for k, figure in enumerate(figures)
    ]
    return Picture(f"figure-{name}", title, caption, Markup("").join(drawn), wide)
