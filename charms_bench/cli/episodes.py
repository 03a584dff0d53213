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
    print_json,
    print_records,
    say,
)


@app.command()
def edge_cases(
    run: RunPath,
    top: Annotated[int, typer.Option(min=1, help="Maximum number of episodes to list.")] = 10,
    kind: Annotated[
        Literal["collision", "near-miss", "hard-braking", "abandoned-lane-change"] | None,
        typer.Option(
            help="Only this kind. In an abandoned lane change, another vehicle takes the gap."
        ),
    ] = None,
    agent: EgoLabel = None,
    traffic: TrafficLabel = None,
    suite_folder: SuiteFolder = Path(),
    as_json: Json = False,
) -> None:
    """Rank the episodes of a run by criticality and describe each one."""
    from charms_bench import api

    opened = api.open_run(run, suite_folder)
    found = [asdict(case) for case in opened.edge_cases(top, kind, agent, traffic)]
    if as_json:
        print_json(found)
        return
    if not found:
        say(f"No {kind} in {run}.")
        return
    forms = {"ego": "", "traffic": "", "episode": ".0f", "criticality": ".2f", "what happened": ""}
    print_records("rank", [{**case, "what happened": case["what"]} for case in found], forms)


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
    slugs = [re.sub(r"\W+", "-", title).strip("-").lower() for title in (ego, around)]
    name = f"{'-in-'.join(slugs)}-{episode}"
    animation = output or run / "replays" / f"{name}.gif"
    trajectories = animation.with_suffix(".parquet")
    what = replayed.what_happened()
    write_atomically(trajectories, replayed.trajectories().write_parquet)
    replayed.animate(animation)
    if as_json:
        facts = {"ego": ego, "traffic": around, "episode": episode, "ending": replayed.ending}
        facts |= {"duration_s": float(replayed.t_s[-1]), "what": what}
        print_json({**facts, "animation": str(animation), "trajectories": str(trajectories)})
        return
    say(f"{ego} in {around}, episode {episode}: {what}")
    say(f"Animation: {animation}\nTrajectories: {trajectories}")
