"""`show`: what a run came to, in the terminal."""

import json
from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import Json, app, out, plain
from charms_bench.errors import InputError, RunFolderError


@app.command()
def show(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="The folder of an evaluation or a training.")
    ],
    metrics: Annotated[
        list[str] | None,
        typer.Option("--metric", help="Only this one; may be given again."),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All metrics, not only the suite's columns.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Print the tables of a run, every value in its interval and drawn to scale."""
    from charms_bench.report.stored import holds
    from charms_bench.report.training_tables import stored_training
    from charms_bench.runs.folder import MANIFEST

    if holds(run, MANIFEST):
        _show_evaluation(run, metrics or [], everything, as_json)
        return
    if metrics or everything:
        raise InputError(f"{run}: is no evaluation; --metric and --all are for those")
    training = stored_training(run)
    if training.stages is None and training.curves is None:
        raise RunFolderError(
            f"{run}: holds no evaluation ({MANIFEST}) and no finished training (stages.csv)"
        )
    if as_json:
        found = {
            "stages": None if training.stages is None else training.stages.records(),
            "curves": None if training.curves is None else training.curves.to_dicts(),
        }
        print(
            json.dumps({name: rows for name, rows in found.items() if rows is not None}, indent=2)
        )
        return
    from charms_bench.report.terminal import grid
    from charms_bench.report.training_tables import drawn_curves

    if training.stages is not None:
        out.print(grid(training.stages, out.width))
    out.print(drawn_curves(training, out.width))


def _show_evaluation(run: Path, metrics: list[str], everything: bool, as_json: bool) -> None:
    from charms_bench.report.stored import stored_tables
    from charms_bench.report.suite_table import shown_metrics
    from charms_bench.report.terminal import drawn
    from charms_bench.runs.folder import RunFolder

    folder = RunFolder(run)
    suite = folder.suite()
    tables = stored_tables(run, suite)
    table, *others = tables.each()
    if metrics:
        table, others = table.select(*metrics), []
    if as_json:
        found = {
            "suite": suite.suite,
            "title": suite.title,
            "episodes": suite.episodes,
            "seed": suite.seed,
            "tables": {each.name: each.frame().to_dicts() for each in (table, *others)},
        }
        print(json.dumps(found, indent=2, ensure_ascii=False))
        return
    title = suite.title or suite.suite
    engine = folder.manifest().get("engine")
    cells = f"{len(suite.egos)} × {len(suite.traffics)} cells"
    facts = f"{cells} of {suite.episodes:,} episodes, seeds from {suite.seed:,}, engine {engine}"
    out.print(plain(f"{title}\n{facts}"), highlight=False, soft_wrap=True)
    if not metrics and not everything:
        table = table.select(*shown_metrics(table, suite.columns))
    for each in (table, *others):
        out.print(drawn(each, out.width))
