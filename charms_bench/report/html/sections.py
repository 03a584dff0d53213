"""The parts of a report, a run each: its tables and the figures that they call for."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl
from markupsafe import Markup
from matplotlib.figure import Figure

from charms_bench.people.reference import read_references
from charms_bench.report.html.apart import PLACED, draw_places, draw_separations
from charms_bench.report.html.beside_paper import draw_beside_paper
from charms_bench.report.html.definitions import Definition, define_distances, define_paired
from charms_bench.report.html.learning import draw_curves
from charms_bench.report.html.sources import Evaluation, Training
from charms_bench.report.html.svg import Picture, in_page
from charms_bench.report.html.tables import (
    Shown,
    all_tables,
    chosen_tables,
    pairs_table,
    realism_tables,
    stages_table,
)
from charms_bench.report.matrix import SHOWN, draw_matrices
from charms_bench.report.realism import TITLE
from charms_bench.report.realism_figures import draw_distributions, recorded
from charms_bench.report.tradeoff import OF_EGOS, OF_TRAFFICS, draw_tradeoff
from charms_bench.runs.suite import Suite

WIDE = (9.6, 4.4)
"""Size of a figure as wide as the page, inches."""


@dataclass(frozen=True)
class Section:
    """A part of the report."""

    id: str
    title: str
    facts: tuple[str, ...]
    """What was run, in a few words each."""
    tables: tuple[Shown, ...]
    pictures: tuple[Picture, ...]
    more: tuple[Shown, ...] = ()
    """Tables for who wants all of it."""
    drawn_first: bool = False
    """Whether the figures say more than the tables."""


def evaluation_section(source: Evaluation, folder: Path) -> Section:
    """A run of a suite; relative paths in it start at `folder`."""
    suite, long = source.run.suite, source.tables[""]
    scene, last = suite.scene, suite.seed + suite.episodes - 1
    tables = chosen_tables(long, suite.columns)
    if "-realism" in source.tables:
        tables += realism_tables(source.tables["-realism"], define_distances())
    more = all_tables(long)
    if "-pairs" in source.tables:
        more.append(pairs_table(source.tables["-pairs"], define_paired()))
    return Section(
        id=f"run-{source.key}",
        title=suite.title or suite.suite,
        facts=(
            f"{_counted(len(suite.egos), 'ego')} in {_counted(len(suite.traffics), 'traffic')}",
            f"{suite.episodes:,} episodes each, seeds {suite.seed:,} to {last:,}",
            f"{scene.lanes} lanes, {scene.vehicles} vehicles, density {scene.density:g}",
            f"{scene.duration_s:g} s an episode",
            f"run folder {source.path.name}",
        ),
        tables=tuple(tables),
        pictures=tuple(_pictures(source) + _realism(source, folder)),
        more=tuple(more),
        drawn_first=_is_crossplay(suite),
    )


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count > 1)}"


def _is_crossplay(suite: Suite) -> bool:
    return len(suite.egos) > 1 and len(suite.traffics) > 1


def training_section(source: Training) -> Section:
    """A run of a pipeline."""
    stages = source.curves["stage"].unique(maintain_order=True)
    pictures = tuple(
        _picture(f"{source.key}-{k}", title, _LEARNING, figure)
        for k, (title, figure) in enumerate(draw_curves(source.curves).items())
    )
    return Section(
        id=f"run-{source.key}",
        title="Training and fine-tuning",
        facts=(f"{len(stages)} stages", f"run folder {source.path.name}"),
        tables=() if source.stages is None else (stages_table(source.stages),),
        pictures=pictures,
    )


_LEARNING = "A line a stage. What is over steps was measured while it explored."


def _pictures(source: Evaluation) -> list[Picture]:
    suite, long, key = source.run.suite, source.tables[""], source.key
    pictures = []
    if beside := draw_beside_paper(long):
        pictures.append(
            _picture(
                f"{key}-paper",
                "Beside the paper",
                "Discs with 95 % intervals: this run. Diamonds: the paper. An interval that is "
                "narrower than its disc is not seen.",
                *beside,
                wide=True,
            )
        )
    standard = long.filter(pl.col("metric_set").str.starts_with("standard-"))
    if _is_crossplay(suite):
        pictures += [
            _picture(
                f"{key}-{metric}",
                "Cross-play",
                "Egos down, traffics across. The darker, the higher; intervals are in the tables.",
                draw_matrices(long, [metric]),
            )
            for metric in SHOWN
            if _has(standard, metric)
        ]
    of_egos = len(suite.egos) > 1
    tradeoff = OF_EGOS if of_egos else OF_TRAFFICS
    if len(suite.cells) > 1 and _has(long, tradeoff.across, tradeoff.share):
        pictures.append(
            _picture(
                f"{key}-tradeoff",
                "Speed against safety" if of_egos else "Density against safety",
                "With 95 % intervals. Further right and further down is better."
                if of_egos
                else "With 95 % intervals.",
                draw_tradeoff(long, tradeoff, *WIDE),
                wide=True,
            )
        )
    if "-pairs" in source.tables:
        if _has(long, *PLACED):
            pictures.append(
                _picture(
                    f"{key}-places",
                    "Styles apart: where each stands",
                    "Mean speed and mean headway to the leader, with 95 % intervals.",
                    draw_places(long),
                )
            )
        pictures.append(
            _picture(
                f"{key}-separations",
                "Styles apart: pair by pair",
                "In how many metrics the two differ by more than chance (Holm-corrected p < 0.05), "
                f"of {source.tables['-pairs']['metric'].n_unique()}.",
                draw_separations(source.tables["-pairs"]),
            )
        )
    return pictures


def _has(long: pl.DataFrame, *metrics: str) -> bool:
    """Whether all of these were measured; a run may be scored by other metrics."""
    return set(metrics) <= set(long.drop_nulls("value")["metric"])


def _realism(source: Evaluation, folder: Path) -> list[Picture]:
    suite = source.run.suite
    if not suite.references:
        return []
    following = source.run.following()
    references = read_references(suite.references, folder)
    return [
        _picture(
            f"{source.key}-{quantity}-{k}",
            f"{TITLE[quantity]}: {reference}",
            "Grey: people. Lines: traffics.",
            draw_distributions(quantity, following, {reference: counts}),
        )
        for quantity in TITLE
        for k, (reference, counts) in enumerate(recorded(quantity, references).items())
    ]


def _picture(name: str, title: str, caption: str, *figures: Figure, wide: bool = False) -> Picture:
    """Figures under their title, described by title and caption."""
    drawn = [
        in_page(figure, f"{name}-{k}", f"{title}. {caption}") for k, figure in enumerate(figures)
    ]
    return Picture(f"figure-{name}", title, caption, Markup("").join(drawn), wide)


def definitions_of(sections: Sequence[Section]) -> list[Definition]:
    """Every definition that a number links to, once."""
    tables = [table for section in sections for table in (*section.tables, *section.more)]
    found = {each.id: each for table in tables for each in table.columns}
    return list(found.values())
