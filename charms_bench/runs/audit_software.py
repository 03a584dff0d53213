"""Compares the manifest of a run with what the installed software writes.

What other software has made cannot be checked, so every difference is `unknown`, and its finding
says what to install. Whether a manifest lies does not matter: the audit compares the rows with
those of the installed software.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from charms_bench.errors import CharmsBenchError
from charms_bench.plugins.specs import AgentSpec
from charms_bench.runs.audit_finding import Finding
from charms_bench.runs.code_hashes import differences, library_versions, module_blobs, row_modules
from charms_bench.runs.manifest import differing_fields
from charms_bench.runs.resumable_folder import RunFolder
from charms_bench.runs.runner import plan_cell
from charms_bench.runs.shard import ShardTask, forget_agents
from charms_bench.runs.shard_names import Shard
from charms_bench.runs.suite import Cell, Suite

LISTED = 5
"""Most modules that a finding lists."""
_COMPARED_APART = ("agents", "versions", "commit", "modules", "machine")
"""Fields of a manifest that are compared in other ways, or differ from machine to machine."""


@dataclass(frozen=True)
class Planned:
    """A cell, as the installed software runs it."""

    cell: Cell
    tasks: Mapping[str, tuple[Shard, ShardTask]]
    """Its shards and how to simulate them, by name; empty if it cannot be run."""
    agents: Mapping[str, Mapping[str, str]]
    problem: str
    """Why it cannot be run; empty if it can."""
    own: frozenset[str]
    """The shards in the folder with the keys of the installed software.

    A key is a hash of the code, the libraries, the agents and the settings that decide rows. So
    these shards were made with the installed software, or are claimed to be.
    """


def planned_again(folder: RunFolder, suite: Suite, names: Collection[str]) -> list[Planned]:
    """Plans every cell of a suite; `names` are those of the shards in its run folder."""
    forget_agents()
    found = []
    for index, cell in enumerate(suite.cells):
        try:
            planned = plan_cell(suite, index, folder)
        except CharmsBenchError as error:
            found.append(Planned(cell, {}, {}, str(error), frozenset()))
            continue
        tasks = {shard.name: (shard, task) for shard, task in planned.items()}
        agents = next(iter(planned.values())).software.agents
        found.append(Planned(cell, tasks, agents, "", frozenset(tasks.keys() & set(names))))
    return found


def audit_software(
    manifest: Mapping[str, Any], suite: Suite, cells: Sequence[Planned]
) -> Iterator[Finding]:
    """Yields where the manifest of a run differs from what the installed software writes."""
    for where, what in (*_code(manifest), *_agents(manifest, cells)):
        yield Finding("software", where, "unknown", what)
    ours = RunFolder.manifest_of(suite, {})
    if manifest.get("modules") == ours["modules"]:
        compared = [name for name in {**manifest, **ours} if name not in _COMPARED_APART]
        one, other = ({name: each.get(name) for name in compared} for each in (manifest, ours))
        for field, said, expected in differing_fields(one, other):
            what = f"is {said!r}; the code of the run writes {expected!r}"
            yield Finding("software", field, "fail", what)


def names_installed_code(manifest: Mapping[str, Any]) -> bool:
    """Returns whether the manifest says that the installed code and libraries made the rows."""
    return not any(_code(manifest))


def _code(manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Where the manifest names other code or libraries than the installed ones, and what to do."""
    recorded, blobs = manifest.get("modules", {}), module_blobs()
    release, made_from = f"charms-bench {manifest.get('charms_bench')}", manifest.get("commit")
    if not recorded:
        yield "modules", f"the manifest does not name the code of the run, {release}"
    elif other := [name for name in row_modules() if recorded.get(name) != blobs[name]]:
        blob = next((recorded[name] for name in other if name in recorded), "")
        how = f"git log --all --find-object={blob}" if blob else "the history"
        found = f"commit {made_from}" if made_from else f"the commit that `{how}` names"
        what = f"{_listed(other)} {'are' if len(other) > 1 else 'is'} not the code of the run"
        yield "modules", f"{what}, which was {release}; to check its rows, install {found}"
    if missing := sorted(set(library_versions()) - set(manifest.get("versions", {}))):
        yield "libraries", f"the manifest does not name the version of {_listed(missing)}"
    if changed := differences(library_versions(), manifest.get("versions", {})):
        yield "libraries", f"{changed}; install these versions"


def _agents(manifest: Mapping[str, Any], cells: Sequence[Planned]) -> Iterator[tuple[str, str]]:
    """Where the agents of the cells are not those in the manifest, or cannot be made."""
    recorded = manifest.get("agents", {})
    for cell in cells:
        if cell.problem:
            yield cell.cell.title, f"{cell.problem}{_remedy(cell.problem, recorded)}"
    installed = {name: identity for cell in cells for name, identity in cell.agents.items()}
    for name, identity in installed.items():
        if identity != recorded.get(name):
            how = differences(identity, recorded.get(name, {})) or "the manifest does not name it"
            yield name, f"is not the agent of the run: {how}"
    if not any(cell.problem for cell in cells):
        for name in sorted(recorded.keys() - installed.keys()):
            yield name, "is in the manifest, but not in the suite"


def _remedy(problem: str, recorded: Mapping[str, Mapping[str, str]]) -> str:
    """Which distribution to install if the problem is a plugin of the run that is missing."""
    for key, identity in recorded.items():
        name = AgentSpec.model_validate_json(key).name if key.startswith("{") else key
        name = name.removeprefix("traffic ")
        of = f"{identity.get('distribution')} {identity.get('version')}"
        if f"named '{name}'" in problem and identity.get("distribution"):
            return f" '{name}' was of {of}; install that"
    return ""


def _listed(names: Collection[str]) -> str:
    more = len(names) - LISTED
    return ", ".join([*names][:LISTED]) + (f" and {more} more" if more > 0 else "")
