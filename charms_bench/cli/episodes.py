"""`edge-cases` and `replay`: single episodes of a run."""

import re
from dataclasses import asdict
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
    out,
    print_json,
    say,
)


@app.command()
def edge_cases(
    run: RunPath,
    top: Annotated[int, typer.Option(min=1, help="Maximum number of episodes to list.")] = 10,
    kind: Annotated[
        Literal["collision", "near-miss", "hard-braking", "abandoned-lane-change"] | None,
        typer.Option(
            help="List only this kind. In an abandoned lane change, another vehicle took the gap."
        ),
    ] = None,
    agent: EgoLabel = None,
    traffic: TrafficLabel = None,
    suite_folder: SuiteFolder = Path(),
    as_json: Json = False,
) -> None:
    """Rank the episodes of a run by criticality and describe each one."""
    from charms_bench import api
    from charms_bench.report.table import Column, Table
    from charms_bench.report.terminal import grid

    found = [
        asdict(case)
        for case in api.open_run(run, suite_folder).edge_cases(top, kind, agent, traffic)
    ]
    if as_json:
        print_json(found)
        return
    if not found:
        say(f"No {kind} in {run}.")
        return
    columns = (
        Column("ego"),
        Column("traffic"),
        Column("episode", form=".0f"),
        Column("criticality", form=".2f"),
        Column("what happened"),
    )
    records = [{**case, "what happened": case["what"]} for case in found]
    table = Table.from_records(records, "edge-cases", "", ("rank",), columns)
    out.print(grid(table, out.width, stacked=False))


@app.command()
def replay(
    run: RunPath,
    episode: Annotated[
        int, typer.Argument(min=0, help="Seed of the episode, as in the output of edge-cases.")
    ],
    agent: EgoLabel = None,
    traffic: TrafficLabel = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.gif",
            help="File of the animation; the trajectories are written beside it.",
        ),
    ] = None,
    suite_folder: SuiteFolder = Path(),
    as_json: Json = False,
) -> None:
    """Simulate an episode again and write an animation and trajectories."""
    from charms_bench import api
    from charms_bench.episodes.animation import check_animation
    from charms_bench.world.files import write_atomically

    if output is not None:
        check_animation(output)
    replayed = api.open_run(run, suite_folder).replay(episode, agent, traffic)
    ego, around = replayed.cell.ego.title, replayed.cell.traffic.title
    name = f"{_slug(ego)}-in-{_slug(around)}-{episode}"
    animation = output or run / "replays" / f"{name}.gif"
    trajectories = animation.with_suffix(".parquet")
    what = replayed.what_happened()
    write_atomically(trajectories, replayed.trajectories().write_parquet)
    replayed.animate(animation)
    if as_json:
        print_json(
            {
                "ego": ego,
                "traffic": around,
                "episode": episode,
                "ending": replayed.ending,
                "duration_s": float(replayed.t_s[-1]),
                "what": what,
                "animation": str(animation),
                "trajectories": str(trajectories),
            }
        )
        return
    say(f"{ego} in {around}, episode {episode}: {what}")
    say(f"Animation: {animation}")
    say(f"Trajectories: {trajectories}")


def _slug(title: str) -> str:
    """A title as part of a file's name."""
    return re.sub(r"\W+", "-", title).strip("-").lower()
