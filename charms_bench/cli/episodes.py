"""`edge-cases` and `replay`: the episodes of a run, one by one."""

import json
import re
from pathlib import Path
from typing import Annotated, Literal

import typer

from charms_bench.cli.terminal import Json, app, out, plain

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a finished run.")]
EgoTitle = Annotated[str | None, typer.Option("--agent", help="The ego, as tables call it.")]
TrafficTitle = Annotated[
    str | None, typer.Option("--traffic", help="The traffic, as tables call it.")
]
SuiteFolder = Annotated[
    Path, typer.Option(help="Where the suite was, at which paths of its networks start.")
]


@app.command()
def edge_cases(
    run: RunPath,
    top: Annotated[int, typer.Option(min=1, help="How many at most.")] = 10,
    kind: Annotated[
        Literal["collision", "near-miss", "hard-braking", "abandoned-lane-change"] | None,
        typer.Option(
            help="Only those. An abandoned lane change is one whose gap another vehicle took."
        ),
    ] = None,
    agent: EgoTitle = None,
    traffic: TrafficTitle = None,
    suite_folder: SuiteFolder = Path(),
    as_json: Json = False,
) -> None:
    """Rank a run's episodes by how near they came to harm, and say what happened in each."""
    from rich.table import Table

    from charms_bench.episodes import edge_cases as ranking
    from charms_bench.episodes.replay import find_cells
    from charms_bench.runs.finished import open_finished

    opened = open_finished(run)
    cells = find_cells(opened, agent, traffic)
    found = ranking.edge_cases(opened, top, kind, cells, suite_folder)
    if as_json:
        print(json.dumps([case.to_dict() for case in found], indent=2, ensure_ascii=False))
        return
    if not found:
        out.print(f"No {kind} in {plain(str(run))}.", highlight=False, soft_wrap=True)
        return
    table = Table(box=None, padding=(0, 1, 0, 0))
    table.add_column("rank", justify="right")
    table.add_column("ego")
    table.add_column("traffic")
    table.add_column("episode", justify="right")
    table.add_column("criticality", justify="right")
    table.add_column("what happened")
    for case in found:
        table.add_row(
            str(case.rank),
            plain(case.ego),
            plain(case.traffic),
            str(case.episode),
            f"{case.criticality:.2f}",
            plain(case.what),
        )
    out.print(table)


@app.command()
def replay(
    run: RunPath,
    episode: Annotated[int, typer.Argument(min=0, help="The episode's seed.")],
    agent: EgoTitle = None,
    traffic: TrafficTitle = None,
    output: Annotated[
        Path | None,
        typer.Option(metavar="OUT.gif", help="The animation; trajectories lie beside it."),
    ] = None,
    suite_folder: SuiteFolder = Path(),
    as_json: Json = False,
) -> None:
    """Simulate an episode of a run again: an animation, and the trajectories of all vehicles."""
    from charms_bench.episodes.animation import check_animation
    from charms_bench.episodes.replay import find_cell
    from charms_bench.episodes.replay import replay as simulate_again
    from charms_bench.runs.finished import open_finished
    from charms_bench.world.files import write_atomically

    opened = open_finished(run)
    cell = find_cell(opened, agent, traffic, "--agent and --traffic")
    chosen = opened.suite.cells[cell]
    name = f"{_slug(chosen.ego.title)}-in-{_slug(chosen.traffic.title)}-{episode}"
    animation = output or run / "replays" / f"{name}.gif"
    check_animation(animation)
    (replayed,) = simulate_again(opened, cell, [episode], suite_folder)
    what = replayed.what_happened()
    trajectories = animation.with_suffix(".parquet")
    write_atomically(trajectories, replayed.trajectories().write_parquet)
    replayed.animate(animation, what)
    if as_json:
        made = {
            "ego": chosen.ego.title,
            "traffic": chosen.traffic.title,
            "episode": episode,
            "ending": replayed.ending,
            "duration_s": float(replayed.t_s[-1]),
            "what": what,
            "animation": str(animation),
            "trajectories": str(trajectories),
        }
        print(json.dumps(made, indent=2, ensure_ascii=False))
        return
    who = f"{chosen.ego.title} in {chosen.traffic.title}, episode {episode}"
    out.print(plain(f"{who}: {what}"), highlight=False, soft_wrap=True)
    out.print(f"Animation: {plain(str(animation))}", highlight=False, soft_wrap=True)
    out.print(f"Trajectories: {plain(str(trajectories))}", highlight=False, soft_wrap=True)


def _slug(title: str) -> str:
    """A title as part of a file's name."""
    return re.sub(r"\W+", "-", title).strip("-").lower()
