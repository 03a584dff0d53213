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
    from charms_bench.report.training import stored_training
    from charms_bench.runs.folder import MANIFEST

    if holds(run, MANIFEST):
        _show_evaluation(run, metrics or [], everything, as_json)
        return
    if metrics or everything:
        raise InputError(f"{run}: is no evaluation; --metric and --all are for those")
    tables = stored_training(run)
    if not tables:
        raise RunFolderError(
            f"{run}: holds no evaluation ({MANIFEST}) and no finished training (stages.csv)"
        )
    if as_json:
        print(json.dumps({name: table.to_dicts() for name, table in tables.items()}, indent=2))
        return
    from charms_bench.report.training import render

    out.print(render(tables, out.width))


def _show_evaluation(run: Path, metrics: list[str], everything: bool, as_json: bool) -> None:
    from charms_bench.errors import suggestion
    from charms_bench.report.show import chosen_metrics, render
    from charms_bench.report.stored import stored_tables
    from charms_bench.runs.folder import RunFolder

    folder = RunFolder(run)
    suite = folder.suite()
    tables = stored_tables(run, suite.suite)
    known = dict.fromkeys(tables[""]["metric"])
    for name in metrics:
        if name not in known:
            raise InputError(f"no metric named '{name}'. {suggestion(name, known)}")
    if metrics:
        tables = {"": tables[""].filter(tables[""]["metric"].is_in(metrics))}
    if as_json:
        found = {
            "suite": suite.suite,
            "title": suite.title,
            "episodes": suite.episodes,
            "seed": suite.seed,
            "tables": {f"{suite.suite}{end}": table.to_dicts() for end, table in tables.items()},
        }
        print(json.dumps(found, indent=2, ensure_ascii=False))
        return
    title = suite.title or suite.suite
    engine = folder.manifest().get("engine")
    cells = f"{len(suite.egos)} × {len(suite.traffics)} cells"
    facts = f"{cells} of {suite.episodes:,} episodes, seeds from {suite.seed:,}, engine {engine}"
    out.print(plain(f"{title}\n{facts}"), highlight=False, soft_wrap=True)
    shown = metrics or ([] if everything else chosen_metrics(tables, suite.columns))
    out.print(render(tables, shown, out.width))
