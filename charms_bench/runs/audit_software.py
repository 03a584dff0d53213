"""Compares the manifest of a run with the installed software, and with the keys of its shards.

Other software than the installed one cannot be checked, so its finding is `unknown`. What
contradicts the keys of the shards or the manifest itself is `false`, whatever else is unknown.
"""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from charms_bench.engine import EngineName
from charms_bench.errors import CharmsBenchError
from charms_bench.plugins.specs import AgentSpec
from charms_bench.runs.audit_finding import Finding, Verdict
from charms_bench.runs.code_hashes import (
    commit,
    differences,
    library_versions,
    module_blobs,
    row_modules,
)
from charms_bench.runs.manifest import differing_fields
from charms_bench.runs.resumable_folder import MANIFEST, RunFolder
from charms_bench.runs.runner import plan_cell
from charms_bench.runs.shard import ShardTask, forget_agents
from charms_bench.runs.shards import Shard
from charms_bench.runs.suite import Cell, Suite

LISTED = 5
"""Most modules that a finding lists."""
_COMPARED_APART = ("suite_sha256", "agents", "versions", "commit", "modules", "machine")
"""Fields of a manifest that are compared in other ways, or differ from machine to machine."""
_KEYS = "but shards have the keys of the installed software"


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
    engine, found = folder.engine(), []
    for index, cell in enumerate(suite.cells):
        try:
            planned = plan_cell(suite, index, engine, folder)
        except CharmsBenchError as error:
            found.append(Planned(cell, {}, {}, str(error), frozenset()))
            continue
        tasks = {shard.name: (shard, task) for shard, task in planned.items()}
        agents = next(iter(planned.values())).software.agents
        found.append(Planned(cell, tasks, agents, "", frozenset(tasks.keys() & set(names))))
    return found


def audit_software(
    manifest: Mapping[str, Any], suite: Suite, engine: EngineName, cells: Sequence[Planned]
) -> Iterator[Finding]:
    """Yields where the manifest of a run differs from what the installed software writes."""
    text = json.dumps(manifest.get("suite"), sort_keys=True)  # as in `Suite.fingerprint`
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    if manifest.get("suite_sha256") != sha256:
        what = f"is not the hash of the suite in {MANIFEST}, {sha256}"
        yield Finding("software", "suite_sha256", "fail", what)
    yield from _code(manifest, any(cell.own for cell in cells))
    yield from _agents(manifest, cells)
    ours = RunFolder.manifest_of(suite, engine, {})
    if manifest.get("modules") == ours["modules"]:
        compared = [name for name in {**manifest, **ours} if name not in _COMPARED_APART]
        one, other = ({name: each.get(name) for name in compared} for each in (manifest, ours))
        for field, said, expected in differing_fields(one, other):
            what = f"is {said!r}; the code of the run writes {expected!r}"
            yield Finding("software", field, "fail", what)


def names_installed_code(manifest: Mapping[str, Any]) -> bool:
    """Returns whether the manifest says that the installed code and libraries made the rows."""
    recorded, blobs = manifest.get("modules", {}), module_blobs()
    return manifest.get("versions") == library_versions() and all(
        recorded.get(name) == blobs[name] for name in row_modules()
    )


def _code(manifest: Mapping[str, Any], is_own: bool) -> Iterator[Finding]:
    """Where the manifest names other code or libraries; shards have our keys if `is_own`."""
    recorded, blobs = manifest.get("modules", {}), module_blobs()
    release, made_from = f"charms-bench {manifest.get('charms_bench')}", manifest.get("commit")
    verdict: Verdict = "fail" if is_own else "unknown"
    if not recorded:
        what = f"the manifest does not name the code of the run, {release}"
        yield Finding("software", "modules", "unknown", what)
    elif recorded != blobs and made_from and made_from == commit():
        other = [name for name in {**blobs, **recorded} if blobs.get(name) != recorded.get(name)]
        what = f"{_listed(other)}: not the code of commit {made_from}, which the manifest names"
        yield Finding("software", "modules", "fail", what)
    elif other := [name for name in row_modules() if recorded.get(name) != blobs[name]]:
        blob = next((recorded[name] for name in other if name in recorded), "")
        how = f"git log --all --find-object={blob}" if blob else "the history"
        found = f"commit {made_from}" if made_from else f"the commit that `{how}` names"
        are = "are" if len(other) > 1 else "is"
        what = (
            f"{_listed(other)} {are} other code in the manifest, {_KEYS}"
            if is_own
            else f"{_listed(other)} {are} not the code of the run, which was {release}; to check "
            f"its rows, install {found}"
        )
        yield Finding("software", "modules", verdict, what)
    if missing := sorted(set(library_versions()) - set(manifest.get("versions", {}))):
        what = f"the manifest does not name the version of {_listed(missing)}"
        yield Finding("software", "libraries", "unknown", what)
    if changed := differences(library_versions(), manifest.get("versions", {})):
        what = f"{changed}; {_KEYS if is_own else 'install these versions'}"
        yield Finding("software", "libraries", verdict, what)


def _agents(manifest: Mapping[str, Any], cells: Sequence[Planned]) -> Iterator[Finding]:
    """Where the agents of the cells are not those in the manifest, or cannot be made."""
    recorded = manifest.get("agents", {})
    for cell in cells:
        if cell.problem:
            what = f"{cell.problem}{_remedy(cell.problem, recorded)}"
            yield Finding("software", cell.cell.title, "unknown", what)
    own = {name for cell in cells if cell.own for name in cell.agents}
    installed = {name: identity for cell in cells for name, identity in cell.agents.items()}
    for name, identity in installed.items():
        if identity == recorded.get(name):
            continue
        how = differences(identity, recorded.get(name, {})) or "the manifest does not name it"
        if name in own:
            what = f"{how} in the manifest, but shards have the key of the installed agent"
            yield Finding("software", name, "fail", what)
        else:
            yield Finding("software", name, "unknown", f"is not the agent of the run: {how}")
    if not any(cell.problem for cell in cells):
        for name in sorted(recorded.keys() - installed.keys()):
            yield Finding("software", name, "fail", "is in the manifest, but not in the suite")


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
