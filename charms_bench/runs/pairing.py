"""Pairs cells of two runs for a comparison: the same episodes, driven by two agents."""

from dataclasses import replace
from typing import Any

from charms_bench.errors import InputError, suggestion
from charms_bench.plugins.specs import by_content
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import FinishedRun
from charms_bench.runs.manifest import differing_fields

Pair = tuple[CellRows, CellRows]


def pairs_of(
    first: FinishedRun, second: FinishedRun | None, egos: tuple[str, str] | None
) -> list[Pair]:
    """Returns the pairs of cells to compare, one per traffic and pair of egos.

    The second run is None if both egos are in the first. The labels of the egos are not needed if
    each run has one ego, or if both have the same.

    Raises:
        InputError: The runs are not of the same episodes, or have no such egos.
        RunFolderError: A row cannot be read.
    """
    if second is None:
        if egos is None:
            known = [ego.title for ego in first.suite.egos]
            raise InputError(
                f"{first.folder.path}: needs something to compare with; give a second run, or two "
                f"egos of this one with --egos: {', '.join(known)}"
            )
        if egos[0] == egos[1]:
            raise InputError(f"--egos: '{egos[0]}' cannot be compared with itself; give two egos")
        return _matched(first, first, [egos])
    check_same_episodes(first, second)
    ours, theirs = ([ego.title for ego in run.suite.egos] for run in (first, second))
    if egos is not None:
        return _matched(first, second, [egos])
    if len(ours) == len(theirs) == 1:
        return _matched(first, second, [(ours[0], theirs[0])])
    if set(ours) == set(theirs):
        return _matched(first, second, [(ego, ego) for ego in ours])
    raise InputError(
        f"{first.folder.path} has {', '.join(ours)}, {second.folder.path} has "
        f"{', '.join(theirs)}: choose one ego of each with --egos"
    )


def check_same_episodes(first: FinishedRun, second: FinishedRun) -> None:
    """Raises an `InputError` that names the first field, but for egos, in which two runs differ."""
    for field, one, other in differing_fields(_conditions(first), _conditions(second)):
        raise InputError(
            f"{first.folder.path} and {second.folder.path} do not have the same episodes: "
            f"{field} is {one} in the first and {other} in the second; run one of them again with "
            "the settings of the other"
        )


def _conditions(run: FinishedRun) -> dict[str, Any]:
    """Returns everything except the egos that episodes and their rows depend on.

    Versions of metrics are left out, because metrics are computed from the rows of both runs when
    they are compared.
    """
    manifest, suite = run.folder.manifest(), run.suite
    traffics = [entry.traffic for entry in suite.traffics]
    named = {name for each in traffics for name in (each.name, *each.mixture)}
    named |= {name for each in traffics if each.scenario for name in each.scenario.agents}
    egos = {ego.agent.origin for ego in suite.egos} - named
    agents = manifest.get("agents", {})
    networks = run.folder.network_hashes()
    return {
        "charms_bench": manifest.get("charms_bench"),
        "scene": suite.scene.model_dump(mode="json"),
        "roads": [each.model_dump(mode="json", exclude={"label"}) for each in suite.roads],
        "seed": suite.seed,
        "episodes": suite.episodes,
        "traffic_models": [by_content(each.model_dump(mode="json"), networks) for each in traffics],
        "agents": by_content({k: agents[k] for k in agents if k not in egos}, networks),
    }


def _matched(first: FinishedRun, second: FinishedRun, agents: list[tuple[str, str]]) -> list[Pair]:
    for run, names in zip((first, second), zip(*agents, strict=True), strict=True):
        known = {ego.title: ego for ego in run.suite.egos}
        for name in names:
            if name not in known:
                raise InputError(
                    f"{run.folder.path}: no ego named '{name}'. {suggestion(name, known)}"
                )
    ours, theirs = (
        {(cell.agent, cell.surroundings): cell for cell in run.cells()} for run in (first, second)
    )
    pairs = []
    # Labels may differ, but `check_same_episodes` has compared the roads and the traffics.
    for place, its_twin in zip(first.suite.surroundings, second.suite.surroundings, strict=True):
        for one, other in agents:
            mine, its = ours[one, place.title], theirs[other, its_twin.title]
            if mine.agent == its.agent:
                mine = replace(mine, agent=f"{one} ({first.folder.path})")
                its = replace(its, agent=f"{other} ({second.folder.path})")
            pairs.append((mine, its))
    return pairs
