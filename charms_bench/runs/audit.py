"""Checks a run folder against its manifest and against a new simulation of some of its shards.

Nothing in the folder is changed.
"""

import hashlib
import secrets
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
import polars as pl

from charms_bench.engine import ENGINES, EngineName
from charms_bench.errors import CharmsBenchError, RunFolderError
from charms_bench.runs.code_hashes import (
    differences,
    library_versions,
    module_blobs,
    row_modules,
)
from charms_bench.runs.folder import CHECKSUMS, KINDS, NETWORKS, RunFolder, Shard
from charms_bench.runs.rare import damaged_files
from charms_bench.runs.runner import SHARD_LIMIT_S, on_this_machine, plan_cell
from charms_bench.runs.shard import ShardFiles, ShardTask, forget_agents
from charms_bench.runs.suite import Cell, Suite
from charms_bench.world.files import read_limited

SHARDS = 10
"""Shards that are simulated again by default. If one in ten is false, this finds it in 65 of 100
audits."""
LISTED = 5
"""Most modules that a finding lists."""

Verdict = Literal["true", "false", "unknown"]
VERDICTS: tuple[Verdict, ...] = ("true", "unknown", "false")
"""From the best to the worst."""


@dataclass(frozen=True)
class Finding:
    """What a check has found."""

    check: str
    """`software`, `files`, `networks`, `rows` or `tables`."""
    where: str
    """The file or the place in it; empty for the check as a whole."""
    verdict: Verdict
    what: str
    """In words."""


@dataclass(frozen=True)
class Asked:
    """What to check."""

    shards: int | None = SHARDS
    """How many shards to simulate again; None is all."""
    seed: int | None = None
    """Chooses the shards; by default another seed each time."""
    workers: int | None = None
    """Processes; by default one per core."""


def audit_run(
    folder: RunFolder,
    suite: Suite,
    asked: Asked,
    progress: Callable[[Cell, int], None] = lambda cell, episodes: None,
    notice: Callable[[str], None] = lambda what: None,
) -> Iterator[Finding]:
    """Yields what is found about the software, files, networks and rows of an evaluation.

    Args:
        folder: The run folder.
        suite: Its suite, with the folder that relative paths start from.
        asked: What to check.
        progress: Called for every shard that has been simulated.
        notice: Called with a message about a problem that was solved.

    Raises:
        RunFolderError: The folder holds no run.
        CharmsBenchError: A shard cannot be simulated.
    """
    manifest = folder.manifest()
    other_code = list(_code(manifest))
    yield from other_code or [_good("software", "the code and libraries of the run are installed")]
    names = {path.stem for path in (folder.path / CHECKSUMS).glob("*.sha256")}
    yield from _networks(folder)
    tasks: dict[Shard, ShardTask] = {}
    for finding in _plan(folder, suite, manifest, tasks):
        other_code.append(finding)
        yield finding
    yield from _files(folder, suite, names, tasks, bool(other_code))
    present = [shard for shard in tasks if shard.name in names]
    if not present:
        what = "none can be simulated again with this software; see above"
        yield Finding("rows", "", "unknown", what)
        return
    seed = secrets.randbits(32) if asked.seed is None else asked.seed
    count = len(present) if asked.shards is None else min(asked.shards, len(present))
    chosen = np.random.default_rng(seed).choice(len(present), count, replace=False)
    sample = {tasks[present[k]]: present[k] for k in sorted(chosen.tolist())}
    engine = _engine(manifest)
    running = on_this_machine(engine, asked.workers, list(sample), SHARD_LIMIT_S, notice)
    wrong = 0
    with closing(running):
        for task, files in running:
            shard = sample[task]
            found = list(_differing_rows(folder, shard, files))
            wrong += bool(found)
            yield from found
            progress(suite.cells[shard.cell], shard.episodes)
    what = (
        f"{wrong} of {count} shards that were simulated again differ"
        if wrong
        else f"{count} of {len(names)} shards, simulated again, have the same rows"
    )
    yield Finding("rows", "", "false" if wrong else "true", f"{what} (seed {seed})")


def _good(check: str, what: str) -> Finding:
    return Finding(check, "", "true", what)


def _code(manifest: Mapping[str, Any]) -> Iterator[Finding]:
    """Where the installed code and libraries are not those of the run."""
    recorded, blobs = _texts(manifest.get("modules")), module_blobs()
    deciding = row_modules()
    release = f"charms-bench {manifest.get('charms_bench')}"
    if not recorded:
        what = f"the manifest does not name the code of the run, {release}"
        yield Finding("software", "modules", "unknown", what)
    other = [name for name in deciding if recorded and recorded.get(name) != blobs[name]]
    if other:
        commit = str(manifest.get("commit") or "")
        blob = next((recorded[name] for name in other if name in recorded), "")
        how = f"git log --all --find-object={blob}" if blob else "the history"
        found = f"commit {commit}" if commit else f"the commit that `{how}` names"
        what = (
            f"{_listed(other)} {'are' if len(other) > 1 else 'is'} not the code of the run, which "
            f"was {release}; to check its rows, install {found}"
        )
        yield Finding("software", "modules", "unknown", what)
    if changed := differences(library_versions(), _texts(manifest.get("versions"))):
        yield Finding("software", "libraries", "unknown", f"{changed}; install these versions")


def _engine(manifest: Mapping[str, Any]) -> EngineName:
    for engine in ENGINES:
        if manifest.get("engine") == engine:
            return engine
    raise RunFolderError(
        f"the manifest says engine {manifest.get('engine')!r}; expected one of {', '.join(ENGINES)}"
    )


def _listed(names: Collection[str]) -> str:
    more = len(names) - LISTED
    return ", ".join([*names][:LISTED]) + (f" and {more} more" if more > 0 else "")


def _texts(value: object) -> dict[str, str]:
    return {str(k): str(v) for k, v in value.items()} if isinstance(value, dict) else {}


def _plan(
    folder: RunFolder, suite: Suite, manifest: Mapping[str, Any], tasks: dict[Shard, ShardTask]
) -> Iterator[Finding]:
    """Plans every cell whose agents are those of the run, and says why others are not."""
    forget_agents()
    engine = _engine(manifest)
    agents = manifest.get("agents")
    recorded = agents if isinstance(agents, dict) else {}
    told = set()
    for index, cell in enumerate(suite.cells):
        try:
            planned = plan_cell(suite, index, engine, folder)
        except CharmsBenchError as error:
            yield Finding("software", cell.title, "unknown", str(error))
            continue
        software = next(iter(planned.values())).software
        other = {
            name: differences(identity, _texts(recorded.get(name)))
            for name, identity in software.agents.items()
            if identity != recorded.get(name)
        }
        for name, how in other.items():
            if name not in told:
                told.add(name)
                what = f"is not the agent of the run: {how or 'the manifest does not name it'}"
                yield Finding("software", name, "unknown", what)
        if not other:
            tasks |= planned


def _networks(folder: RunFolder) -> Iterator[Finding]:
    """Whether the networks in the folder have the hashes in the manifest."""
    wrong, hashes = False, folder.network_hashes()
    copies = {path.stem: path for path in (folder.path / NETWORKS).glob("*.onnx")}
    names = {sha256: name for name, sha256 in hashes.items()}
    for sha256 in sorted({*names, *copies}):
        path = folder.path / NETWORKS / f"{sha256}.onnx"
        whose = f", which is {names[sha256]}" if sha256 in names else ""
        try:
            found = hashlib.sha256(read_limited(path, 2**30)).hexdigest()
        except OSError as error:
            what = f"cannot be read{whose}: {error.strerror}"
        else:
            what = f"has the hash {found}, not the one in its name{whose}" * (found != sha256)
        if what:
            wrong = True
            yield Finding("networks", f"{NETWORKS}/{path.name}", "false", what)
    if not wrong and hashes:
        yield _good("networks", f"{len(hashes)} of {len(hashes)} have the hash in the manifest")


def _files(
    folder: RunFolder,
    suite: Suite,
    names: set[str],
    tasks: Mapping[Shard, ShardTask],
    is_other_code: bool,
) -> Iterator[Finding]:
    """Whether the folder holds the shards of its suite, and each file matches its checksum."""
    wrong = False
    for name in sorted(names):
        for path in folder.damaged_files(name):
            wrong = True
            where = str(path.relative_to(folder.path))
            yield Finding("files", where, "false", "is missing or does not match its checksum")
    for kind in KINDS:
        for path in sorted((folder.path / kind).glob("*")):
            if path.stem not in names:
                wrong = True
                yield Finding("files", f"{kind}/{path.name}", "false", "is not of a finished shard")
    expected = {shard.name: shard for shard in tasks}
    beginnings = {name.rpartition("-")[0]: name for name in names}
    for name, shard in expected.items():
        found = beginnings.get(name.rpartition("-")[0])
        if found is None:
            wrong = True
            what = f"the rows of {tasks[shard].title} are missing"
            yield Finding("files", f"{CHECKSUMS}/{name}.sha256", "false", what)
        elif found != name and not is_other_code:
            wrong = True
            what = (
                f"has a key of other software, agents or settings than the manifest says; "
                f"expected {name}"
            )
            yield Finding("files", f"{CHECKSUMS}/{found}.sha256", "false", what)
    if not wrong:
        yield _good("files", f"the files of {len(names)} shards match their checksums")


def _differing_rows(folder: RunFolder, shard: Shard, files: ShardFiles) -> Iterator[Finding]:
    """Where the rows of a shard differ from those of a new simulation."""
    for kind in KINDS:
        where = f"{kind}/{shard.name}.parquet"
        again = pl.read_parquet(BytesIO(files[kind]))
        try:
            stored = folder.read_unchecked(kind, shard)
        except RunFolderError as error:
            yield Finding("rows", where, "false", str(error))
            continue
        if what := first_difference(stored, again):
            yield Finding("rows", where, "false", what)


def first_difference(stored: pl.DataFrame, again: pl.DataFrame) -> str:
    """Says where rows first differ from those of a new simulation; empty if nowhere."""
    if len(stored) != len(again):
        return f"has {len(stored):,} rows; simulated again, {len(again):,}"
    again = again.select(stored.columns)
    unequal = [~stored[name].eq_missing(again[name]) for name in stored.columns]
    wrong = np.any([each.to_numpy() for each in unequal], axis=0)
    if not wrong.any():
        return ""
    row = int(wrong.argmax())
    column = next(name for name, each in zip(stored.columns, unequal, strict=True) if each[row])
    keys = [name for name in ("episode", "step", "agent", "quantity", "bin") if name in again]
    place = ", ".join(f"{name} {again[name][row]}" for name in keys if name != column)
    more = int(wrong.sum()) - 1
    others = f", and {more} more rows differ" if more else ""
    return (
        f"row {row + 1} ({place}): {column} is {stored[column][row]}; simulated again, "
        f"{again[column][row]}{others}"
    )


def audit_rare(folder: Path) -> Iterator[Finding]:
    """Yields what is found about the files of an estimation of a rare event."""
    damaged = damaged_files(folder)
    for path in damaged:
        where = str(path.relative_to(folder))
        yield Finding("files", where, "false", "does not match the hash in it")
    if not damaged:
        yield _good("files", "the files of all runs match the hashes in them")
    what = (
        "are not simulated again; run `charms-bench rare` with the same suite, event, samples and "
        "seed into another folder, and compare the tables"
    )
    yield Finding("rows", "", "unknown", what)
