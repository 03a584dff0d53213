"""`dataset`: the episodes of a run, for other tools."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from charms_bench.cli.terminal import (
    EgoLabel,
    Json,
    RunPath,
    SuiteFolder,
    TrafficLabel,
    app,
    interruptible,
    print_json,
    say,
)


@app.command()
def dataset(
    run: RunPath,
    kind: Annotated[
        Literal["minari", "highd"],
        typer.Option(
            "--format",
            help="minari: observations, actions and rewards of the ego. highd: trajectories of all "
            "vehicles in highD's format.",
        ),
    ],
    ego: EgoLabel = None,
    traffic: TrafficLabel = None,
    episodes: Annotated[
        int | None,
        typer.Option(min=1, help="Number of episodes, from the first; the default is all."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(help="New folder; the default is one in the run folder."),
    ] = None,
    suite_folder: SuiteFolder = Path(),
    as_json: Json = False,
) -> None:
    """Simulate a run's episodes again and write them as a dataset for other tools."""
    from charms_bench import api

    opened = api.open_run(run, suite_folder)
    with interruptible():
        path = opened.dataset(kind, output, ego=ego, traffic=traffic, episodes=episodes)
    written = episodes or opened.suite.episodes
    if as_json:
        print_json({"format": kind, "episodes": written, "folder": str(path)})
        return
    say(f"{written:,} episodes: {path}")
    if kind == "minari":
        say(f"minari.load_dataset('{path.name}') loads it if MINARI_DATASETS_PATH={path.parent}")
    else:
        say(f"`charms-bench data {path}` summarises it")
