"""`run`: suites of both kinds."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from charms_bench.cli.terminal import (
    Json,
    SuiteFile,
    Workers,
    app,
    interruptible,
    note,
    out,
    plain,
    progress,
)
from charms_bench.errors import InputError


@app.command()
def run(
    suite: SuiteFile,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes of every cell, instead of the suite's.")
    ] = None,
    workers: Workers = None,
    engine: Annotated[
        Literal["batched", "highway-env"], typer.Option(help="highway-env is the slow reference.")
    ] = "batched",
    seed: Annotated[
        int | None, typer.Option(min=0, help="First episode's seed, instead of the suite's.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="The run folder; by default runs/SUITE.")
    ] = None,
    rows: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN", help="Another run's folder; episodes that are the same are taken over."
        ),
    ] = None,
    shard_limit: Annotated[
        float | None,
        typer.Option(
            min=1,
            metavar="SECONDS",
            help="What a worker may take for a part of a cell, its start included; by default "
            "half an hour.",
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Run on the Dask cluster whose scheduler is at tcp://HOST:8786."
        ),
    ] = None,
    only: Annotated[
        str | None, typer.Option(help="One stage of a training suite, with what it needs.")
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option(help="Human driving to train on, instead of the suite's folder.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a suite, or go on with it: what is finished is never run again."""
    from charms_bench.runs.document import Document

    document = Document(suite)
    if "pipeline" in document.data:
        refused = {
            "--episodes": episodes, "--seed": seed, "--rows": rows, "--shard-limit": shard_limit,
            "--cluster": cluster,
        }  # fmt: skip
        for option in (name for name, value in refused.items() if value is not None):
            raise InputError(f"{option} is for evaluations; {suite} is a training")
        folder = output or Path("runs") / suite.stem
        _run_pipeline(document, folder, workers, only, recordings)
        return
    for option, given in {"--only": only, "--recordings": recordings}.items():
        if given is not None:
            raise InputError(f"{option} is for trainings; {suite} is an evaluation")
    if cluster is not None and engine != "batched":
        raise InputError("--cluster runs the engine batched; the reference runs on this machine")
    if cluster is not None and workers is not None:
        raise InputError("--workers are processes on this machine; a cluster has its own")

    from charms_bench.people.reference import read_references
    from charms_bench.report.run_files import write_run
    from charms_bench.report.suite_table import shown_metrics
    from charms_bench.report.terminal import grid
    from charms_bench.runs import runner
    from charms_bench.runs.cluster import on_cluster
    from charms_bench.runs.lock import locked
    from charms_bench.runs.suite import suite_of

    changes = {"episodes": episodes, "seed": seed}
    document.data |= {name: value for name, value in changes.items() if value is not None}
    loaded = suite_of(document)
    references = read_references(loaded.references, loaded.folder)
    folder = output or Path("runs") / loaded.suite
    on_dask = None if cluster is None else on_cluster(cluster)
    total = loaded.episodes * len(loaded.cells)
    with interruptible(f"finished shards are in {folder}"), progress("episodes", total) as bar:
        finished = runner.run(
            loaded,
            folder,
            engine,
            workers,
            lambda cell, count: bar(cell.ego.title, count),
            rows,
            shard_limit or runner.SHARD_LIMIT_S,
            note,
            on_dask,
        )
    with interruptible(f"all rows are in {folder}"), locked(folder):
        following = finished.following() if references else []
        tables, files = write_run(loaded, folder, finished.cells(), following, references)
    table = tables.metrics
    if as_json:
        print(json.dumps(table.frame().to_dicts(), indent=2))
    else:
        if loaded.title:
            out.print(plain(loaded.title), highlight=False)
        shown = table.select(*shown_metrics(table, loaded.columns)).without_constant_keys()
        out.print(grid(shown, out.width))
        for what, paths in files.items():
            listed = ", ".join(plain(str(path)) for path in paths)
            out.print(f"{what}: {listed}", highlight=False, soft_wrap=True)


def _run_pipeline(
    document: Any, output: Path, workers: int | None, only: str | None, recordings: Path | None
) -> None:
    from charms_bench.plugins.registry import PIPELINES, load

    name = document.data["pipeline"]
    if not isinstance(name, str):
        raise document.error(("pipeline",), f"expected a name, found {name!r}")
    pipeline = load(PIPELINES, name)
    with interruptible(f"checkpoints are in {output}"):
        pipeline(document.path, output, workers, only, recordings)
