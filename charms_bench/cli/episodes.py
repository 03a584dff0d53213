"""`rare`, `edge-cases`, `replay`, `what-if` and `search`: failures, and single episodes."""

from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument, Option

import charms_bench
from charms_bench.cli import arguments
from charms_bench.cli.terminal import (
    app,
    end_with_json,
    interruptible,
    print_records,
    print_table,
    say,
    shown,
)
from charms_bench.errors import InputError
from charms_bench.foundation.files import reject_foreign, write_bytes
from charms_bench.foundation.words import counted

if TYPE_CHECKING:
    from charms_bench.api import Run
    from charms_bench.episodes.edge_cases import EdgeCase

BESIDE = ".trajectories.parquet"
"""What ends the name of the table beside an animation of the user's choice."""
Episode = Annotated[
    int, Argument(min=0, help="Seed of the episode, as in the output of edge-cases.")
]
EgoIndex = Annotated[
    int, Option(min=0, help="Which of several egos, as in `edge-cases`; it is vehicle 0.")
]


@app.command(rich_help_panel=arguments.FAILURES)
def rare(
    suite: arguments.AnySuite,
    agents: arguments.EgoAgents = None,
    event: str = Option(
        "crash",
        metavar="NAME[:OPTION=VALUE,...]",
        help="Event: crash, ttc:below_s=1.0, or an event of a plugin.",
    ),
    runs: int = Option(
        10,
        help="Independent runs per ego and traffic model, 5 to 1,000; more runs give a "
        "narrower interval.",
    ),
    samples: int = Option(1000, help="Episodes per level of a run, a multiple of 5, at least 100."),
    seed: int | None = Option(None, min=0, help="Seed of all random draws; overrides the suite."),
    workers: arguments.Workers = None,
    output: Path | None = Option(
        None, help="Folder; the default is runs/SUITE-rare-EVENT, and each --agent."
    ),
    as_json: arguments.Json = False,
) -> None:
    """Estimate the probability of a rare event, such as a crash.

    The command uses subset simulation. The column `plain episodes` shows how many episodes of plain
    simulation would give an interval as narrow. Finished runs are not repeated.
    """
    with interruptible():
        sizes: dict[str, Any] = {"runs": runs, "samples": samples, "seed": seed, "workers": workers}
        made = charms_bench.rare(suite, event, output, agents=agents or (), **sizes)
    if as_json:
        end_with_json(made.table.frame().to_dicts())
    print_table(made.table.without_constant_keys(), stacked=True)
    say(f"Written: {', '.join(map(shown, made.files))}")


@app.command(rich_help_panel=arguments.FAILURES)
def edge_cases(
    run: arguments.RunPath,
    top: int = Option(10, min=1, max=10_000_000, help="Maximum number of episodes to list."),
    kind: Literal["collision", "near-miss", "hard-braking", "abandoned-lane-change"]
    | None = Option(
        None,
        help="List only this kind. In an abandoned lane change, another vehicle takes the gap.",
    ),
    ego: arguments.EgoLabel = None,
    road: arguments.RoadLabel = None,
    traffic: arguments.TrafficLabel = None,
    avoidable: bool = Option(
        False,
        "--avoidable",
        help="For each collision, state the last avoidable moment, and which "
        "agents would have avoided it.",
    ),
    budget: int = Option(
        200_000, min=1, help="For --avoidable: maximum number of decisions per collision."
    ),
    suite_folder: arguments.SuiteFolder = Path(),
    as_json: arguments.Json = False,
) -> None:
    """Rank the episodes of a run by criticality."""
    opened = charms_bench.open_run(run, suite_folder)
    if avoidable and kind not in (None, "collision"):
        raise InputError(f"--avoidable is about collisions, not --kind {kind}")
    cases = opened.edge_cases(top, "collision" if avoidable else kind, ego, traffic, road)
    if avoidable:
        _print_avoidability(opened, cases, budget, as_json)
        return
    found = [asdict(case) for case in cases]
    if as_json:
        end_with_json(found)
    if not found:
        say(f"No {kind} in {run}.")
        return
    forms = {"ego": "", **({"road": ""} if opened.suite.roads else {}), "traffic": ""}
    if any(case["ego_index"] is not None for case in found):
        forms["ego_index"] = ".0f"
    forms |= {"episode": ".0f", "criticality": ".2f", "what happened": ""}
    if opened.suite.preventable_by:
        forms["preventable"] = ""
    records = [
        {**case, "what happened": case["what"], "preventable": case["preventable"] or "–"}
        for case in found
    ]
    print_records("rank", records, forms)
    hz = opened.suite.scene.decision_hz
    say(f"{hz} decision{'s' * (hz != 1)} per second, which `what-if --at` counts from 1.")
    for remark in opened.remarks(ego, traffic):
        say(remark)


def _print_avoidability(opened: "Run", cases: "list[EdgeCase]", budget: int, as_json: bool) -> None:
    """Prints what could have been done about collisions of the egos."""
    from charms_bench.report.avoidability_table import avoidability_table, rescuers_table

    cells: dict[tuple[str, str, str | None, int], list[int]] = {}
    for case in cases:
        if case.ending != "off_road":
            at = case.ego, case.traffic, case.road, case.ego_index or 0
            cells.setdefault(at, []).append(case.episode)
    found = [
        each
        for (ego, around, road, ego_index), episodes in cells.items()
        for each in opened.avoidability(episodes, ego, around, budget, road, ego_index)
    ]
    if as_json:
        end_with_json([asdict(each) for each in found])
    if not found:
        say(f"No collision in {opened.path}.")
        return
    print_table(avoidability_table(found, opened.suite.scene))
    print_table(rescuers_table(found, opened.suite.preventable_by))


@app.command(rich_help_panel=arguments.FAILURES)
def replay(
    run: arguments.RunPath,
    episode: Episode,
    ego: arguments.EgoLabel = None,
    road: arguments.RoadLabel = None,
    traffic: arguments.TrafficLabel = None,
    ego_index: EgoIndex = 0,
    output: Path | None = Option(
        None,
        metavar="OUT.gif",
        callback=arguments.GIF,
        help="File of the animation; the trajectories are written beside it.",
    ),
    commonroad: Path | None = Option(
        None,
        metavar="OUT.xml",
        callback=arguments.XML,
        help="Also write the episode as a CommonRoad scenario.",
    ),
    suite_folder: arguments.SuiteFolder = Path(),
    as_json: arguments.Json = False,
) -> None:
    """Write an animation and the trajectories of an episode."""
    from charms_bench.episodes.dataset import name_of
    from charms_bench.runs.lock import folder_in
    from charms_bench.runs.shard import in_parquet

    if output is not None:
        reject_foreign(output.with_suffix(BESIDE))
    opened = charms_bench.open_run(run, suite_folder)
    replayed = opened.replay(episode, ego, traffic, road, ego_index)
    cell = replayed.cell
    which = "" if replayed.ego_index is None else f"-ego-{replayed.ego_index}"
    name = f"{name_of(opened.suite, replayed.cell)}-{episode}{which}.gif"
    animation = output or folder_in(opened.path, "replays") / name
    trajectories = animation.with_suffix(BESIDE if output else ".parquet")
    what = replayed.what_happened()
    if commonroad is not None:  # first, because it is not possible of every episode
        replayed.write_commonroad(commonroad)
    # polars cannot write to every name that a file can have.
    write_bytes(trajectories, in_parquet(replayed.trajectories()))
    replayed.animate(animation)
    files = {"animation": str(animation), "trajectories": str(trajectories)}
    if commonroad is not None:
        files["commonroad"] = str(commonroad)
    if as_json:
        facts: dict[str, Any] = {"ego": cell.ego.title}
        facts |= {"road": cell.road.title if cell.road else None}
        facts |= {"traffic": cell.traffic.title, "ego_index": replayed.ego_index}
        facts |= {"episode": episode, "ending": replayed.ending}
        facts |= {"duration_s": float(replayed.t_s[-1]), "what": what}
        end_with_json({**facts, **files})
    say(f"{replayed.title}, episode {episode}: {what}")
    titles = {"animation": "Animation", "trajectories": "Trajectories", "commonroad": "CommonRoad"}
    for kind, file in files.items():
        say(f"{titles[kind]}: {shown(Path(file))}")


@app.command(rich_help_panel=arguments.FAILURES)
def what_if(
    run: arguments.RunPath,
    episode: Episode,
    at: int = Option(
        ...,
        "--at",
        metavar="STEP",
        min=1,
        help="First decision of the other agent; decisions are counted from 1.",
    ),
    other: str = Option(
        ..., "--agent", metavar="OTHER", help="An installed agent, or the path of a network."
    ),
    vehicle: int | None = Option(
        None, min=0, help="The vehicle, by its number in replays; the default is the ego."
    ),
    ego: str | None = Option(None, "--ego", help="Label of the recorded ego, as in the tables."),
    road: arguments.RoadLabel = None,
    traffic: arguments.TrafficLabel = None,
    ego_index: EgoIndex = 0,
    output: Path | None = Option(
        None, metavar="OUT.html", callback=arguments.HTML, help="File of the page with the replay."
    ),
    suite_folder: arguments.SuiteFolder = Path(),
    as_json: arguments.Json = False,
) -> None:
    """Let another agent drive from a decision of an episode on."""
    from charms_bench.episodes.dataset import name_of
    from charms_bench.foundation.names import name_of_agent
    from charms_bench.report.html.single import write_what_if
    from charms_bench.report.what_if_table import what_if_table
    from charms_bench.runs.lock import folder_in

    opened = charms_bench.open_run(run, suite_folder)
    found = opened.what_if(episode, at, other, vehicle, ego, traffic, road, ego_index)
    seat = "ego" if found.vehicle == found.recorded.ego else str(found.vehicle)
    cell = name_of(opened.suite, found.recorded.cell)
    which = "" if found.recorded.ego_index is None else f"-ego-{ego_index}"
    name = f"{cell}-{episode}{which}-{seat}-{name_of_agent(other)}-from-{at}.html"
    page = output or folder_in(opened.path, "replays") / name
    write_what_if(found, page)
    recorded, instead = found.sentences()
    if as_json:
        futures = [
            {"recorded": asdict(one), "what_if": asdict(two)} for one, two in found.futures()
        ]
        facts = {"episode": episode, "step": at, "vehicle": found.vehicle, "agent": other}
        facts |= {"recorded": recorded, "what_if": instead, "futures": futures}
        end_with_json({**facts, "page": str(page)})
    say(f"Recorded: {recorded}\nWhat if:  {instead}")
    print_table(what_if_table(found))
    say(f"Page: {shown(page)}")


@app.command(rich_help_panel=arguments.FAILURES)
def search(
    suite: Path = Argument(
        metavar="SUITE", help="YAML file with a scenario, or with a road that has `parameters`."
    ),
    agent: str | None = Option(
        None, help="Installed agent, or ONNX file of a network, instead of --ego."
    ),
    ego: str | None = Option(None, help="Label of an ego of the suite, or an installed agent."),
    traffic: str | None = Option(
        None, help="Label of the scenario, or of the traffic model on the road."
    ),
    road: arguments.RoadLabel = None,
    failures: int = Option(10, min=1, help="Number of failures after which the search ends."),
    budget: int = Option(5000, min=1, help="Number of episodes after which the search ends."),
    seed: int = Option(0, min=0, help="Seed of the search."),
    output: Path | None = Option(
        None, "--output", "-o", help="Folder; the default is runs/SUITE-search, and --agent."
    ),
    as_json: arguments.Json = False,
) -> None:
    """Search the parameters of a scenario or of a road for failures of an agent.

    A failure is a collision that a driver named by `preventable_by` avoids in the same scenario.
    The folder has them as a suite, `found.yaml`. An interrupted search continues.
    """
    from charms_bench.episodes.search import FOUND

    with interruptible():
        limits = {"failures": failures, "budget": budget, "seed": seed}
        made = charms_bench.search(suite, ego, traffic, output, road=road, agent=agent, **limits)
    assert made.path is not None
    found = shown(made.path / FOUND)
    if as_json:
        facts = {"failures": made.failures, "preventable_by": made.preventable_by}
        facts |= {"episodes": made.simulations, "left_out": made.left_out}
        facts |= {"episodes_to_first": made.simulations_to_first}
        end_with_json({**facts, "suite": found if made.failures else None})
    where, episodes = made.cell.title, counted(made.simulations, "episode")
    if made.left_out:
        episodes += f" ({made.left_out:,} left out: prescribed vehicles collide with one another)"
    if not made.failures:
        say(f"{where}: no failure in {episodes}")
        return
    say(
        f"{where}: {counted(len(made.failures), 'failure')} in {episodes}, the first in the "
        f"batch that ended after {made.simulations_to_first:,}"
    )
    forms = dict.fromkeys(made.failures[0], ".5g")
    records: list[dict[str, Any]] = [
        {"failure": str(k), **point} for k, point in enumerate(made.failures)
    ]
    if made.references:
        forms["preventable by"] = ""
        for record, names in zip(records, made.preventable_by, strict=True):
            record["preventable by"] = " and ".join(names)
    print_records("failure", records, forms)
    say(f"Written: {found}; run it with `charms-bench run {quote(str(found))}`")
