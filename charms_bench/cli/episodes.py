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
    interruptible,
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


@app.command()
def search(
    suite: Annotated[Path, typer.Argument(metavar="SUITE", help="YAML file with a scenario.")],
    agent: Annotated[
        str | None,
        typer.Option(help="Label of an ego of the suite, or an installed agent."),
    ] = None,
    traffic: Annotated[str | None, typer.Option(help="Label of the scenario.")] = None,
    failures: Annotated[
        int, typer.Option(min=1, help="Number of failures after which the search ends.")
    ] = 10,
    budget: Annotated[
        int, typer.Option(min=1, help="Number of episodes after which the search ends.")
    ] = 5000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Suite of the failures to write.")
    ] = Path("found.yaml"),
    as_json: Json = False,
) -> None:
    """Search a scenario for failures of an agent, and write them as a suite.

    A failure is a collision that the suite's driver preventable_by avoids in the same scenario.
    """
    from charms_bench import api

    with interruptible():
        made = api.search(
            suite, agent, traffic, output, failures=failures, budget=budget, seed=seed
        )
    if as_json:
        print_json(
            {
                "failures": made.failures,
                "episodes": made.simulations,
                "episodes_to_first": made.simulations_to_first,
                "suite": str(output) if made.failures else None,
            }
        )
        return
    where = f"{made.cell.ego.title} in {made.cell.traffic.title}"
    if not made.failures:
        say(f"{where}: no failure in {made.simulations:,} episodes")
        return
    say(
        f"{where}: {len(made.failures)} failures in {made.simulations:,} episodes, the first after "
        f"{made.simulations_to_first:,}"
    )
    forms = dict.fromkeys(made.failures[0], ".3f")
    records = [{"failure": str(k), **point} for k, point in enumerate(made.failures)]
    print_records("failure", records, forms)
    say(f"Written: {output}; run it with `charms-bench run {output}`")
