"""Finds the cells of two runs that can be compared: the same episodes, driven by two agents."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from charms_bench.errors import InputError, suggestion
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished import FinishedRun

Pair = tuple[CellRows, CellRows]


def pairs_of(
    first: FinishedRun, second: FinishedRun | None, agents: tuple[str, str] | None
) -> list[Pair]:
    """The cells to compare, traffic by traffic.

    Args:
        first: The run of the first agent.
        second: The run of the second agent; none for another agent of the same run.
        agents: Their names in tables; not needed for two runs of one ego each, or of the same
            egos.

    Raises:
        InputError: The two runs have different episodes, or have no such agents.
        RunFolderError: A row cannot be read.
    """
    if second is None:
        if agents is None:
            egos = [ego.title for ego in first.suite.egos]
            raise InputError(
                f"{first.folder.path}: compared with what? Give a second run, or two of its "
                f"agents with --agents: {', '.join(egos)}"
            )
        return _matched(first, first, [agents])
    check_same_episodes(first, second)
    ours, theirs = ([ego.title for ego in run.suite.egos] for run in (first, second))
    if agents is not None:
        return _matched(first, second, [agents])
    if len(ours) == len(theirs) == 1:
        return _matched(first, second, [(ours[0], theirs[0])])
    if set(ours) == set(theirs):
        return _matched(first, second, [(ego, ego) for ego in ours])
    raise InputError(
        f"{first.folder.path} has {', '.join(ours)}, {second.folder.path} has "
        f"{', '.join(theirs)}: say with --agents which one of each to compare"
    )


def check_same_episodes(first: FinishedRun, second: FinishedRun) -> None:
    """Makes sure that two runs have everything but the egos in common.

    Raises:
        InputError: They do not; names the first field that differs.
    """
    ours, theirs = (dict(_leaves(_conditions(run))) for run in (first, second))
    for field in [*ours, *theirs]:
        if ours.get(field) != theirs.get(field):
            raise InputError(
                f"{first.folder.path} and {second.folder.path} do not have the same episodes: "
                f"{field} is {ours.get(field)} in the first and {theirs.get(field)} in the "
                "second; run one of them again with the settings of the other"
            )


def _conditions(run: FinishedRun) -> dict[str, Any]:
    """What decides episodes and their rows, apart from the egos.

    Metrics are computed from the rows when they are compared, so both runs get the same versions
    of them; what a row means depends on the harness's version.
    """
    manifest, suite = run.folder.manifest(), run.suite
    traffics = [entry.traffic for entry in suite.traffics]
    named = {name for traffic in traffics for name in (traffic.name, *traffic.mixture)}
    egos = {ego.agent.key for ego in suite.egos} - named
    agents = manifest.get("agents", {})
    return {
        "charms_bench": manifest.get("charms_bench"),
        "scene": suite.scene.model_dump(mode="json"),
        "seed": suite.seed,
        "episodes": suite.episodes,
        "traffics": [traffic.model_dump(mode="json") for traffic in traffics],
        "agents": {name: found for name, found in agents.items() if name not in egos},
    }


def _leaves(value: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """The values of nested dictionaries and lists, each with its place."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{at}.{key}".lstrip("."))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _leaves(inner, f"{at}[{index}]")
    else:
        yield at, value


def _matched(first: FinishedRun, second: FinishedRun, agents: list[tuple[str, str]]) -> list[Pair]:
    for run, names in zip((first, second), zip(*agents, strict=True), strict=True):
        known = {ego.title: ego for ego in run.suite.egos}
        for name in names:
            if name not in known:
                raise InputError(
                    f"{run.folder.path}: no ego named '{name}'. {suggestion(name, known)}"
                )
    ours = {(cell.agent, cell.traffic): cell for cell in first.cells()}
    same = first is second
    theirs = ours if same else {(cell.agent, cell.traffic): cell for cell in second.cells()}
    # Labels of traffics may differ: `check_same_episodes` has checked that they are the same.
    traffics = zip(first.suite.traffics, second.suite.traffics, strict=True)
    pairs = [
        (ours[one, traffic.title], theirs[other, its_twin.title])
        for traffic, its_twin in traffics
        for one, other in agents
    ]
    return pairs if same else [_told_apart(first, second, pair) for pair in pairs]


def _told_apart(first: FinishedRun, second: FinishedRun, pair: Pair) -> Pair:
    """The pair; agents with the same name get the names of their runs too."""
    one, other = pair
    if one.agent != other.agent:
        return pair
    return (
        replace(one, agent=f"{one.agent} ({first.folder.path})"),
        replace(other, agent=f"{other.agent} ({second.folder.path})"),
    )
