"""Checks a run folder against its manifest and against a new simulation of some of its shards.

Nothing in the folder is changed.
"""

import secrets
from collections.abc import Callable, Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.errors import RunFolderError
from charms_bench.foundation.progress import Tell
from charms_bench.foundation.words import counted
from charms_bench.runs.audit_files import audit_files, audit_networks
from charms_bench.runs.audit_finding import Finding, Verdict
from charms_bench.runs.audit_software import audit_software, planned_again
from charms_bench.runs.rare import damaged_files
from charms_bench.runs.resumable_folder import KINDS, RunFolder
from charms_bench.runs.runner import SHARD_LIMIT_S, on_this_machine
from charms_bench.runs.shard import ShardFiles, simulate
from charms_bench.runs.shard_names import Shard, places_of
from charms_bench.runs.suite import Suite


def audit_run(
    folder: RunFolder,
    suite: Suite,
    shards: int | None,
    seed: int | None,
    workers: int | None,
    tell: Tell,
    notice: Callable[[str], None],
) -> Iterator[Finding]:
    """Yields what is found about the software, files, networks and rows of an evaluation.

    `shards`, `seed` and `workers` are those of `charms_bench.audit`. `tell` is called for every
    shard that has been simulated, and `notice` with a message about a problem that was solved. An
    error is raised if the folder holds no run, or a shard cannot be simulated.
    """
    cells = planned_again(folder, suite, folder.finished())
    software = list(audit_software(folder.manifest(), folder.written_suite(), cells))
    good = Finding("software", "", "pass", "the code and libraries of the run are installed")
    yield from software or [good]
    yield from audit_networks(folder)
    yield from audit_files(folder, suite, cells, is_same=not software)
    tasks = [each for cell in cells for name, each in cell.tasks.items() if name in cell.own]
    if not tasks:
        what = "none can be simulated again with this software; see above"
        yield Finding("rows", "", "unknown", what, undrawn=1.0)
        return
    seed = secrets.randbits(32) if seed is None else seed
    count = len(tasks) if shards is None else min(shards, len(tasks))
    chosen = np.random.default_rng(seed).choice(len(tasks), count, replace=False)
    sample = {task: shard for shard, task in (tasks[k] for k in sorted(chosen.tolist()))}
    running = on_this_machine(simulate, workers, sample, SHARD_LIMIT_S, notice)
    wrong = 0
    with closing(running):
        for task, files in running:
            shard = sample[task]
            found = list(_differing_rows(folder, shard, files))
            wrong += bool(found)
            yield from found
            tell(cells[shard.cell].cell.ego.title, 1)
    whole = len(places_of(suite))
    what = (
        f"{wrong} of {counted(count, 'shard')} that were simulated again differ"
        if wrong
        else f"{count} of {whole} shards, simulated again, have the same rows"
    )
    verdict: Verdict = "fail" if wrong else "pass"
    yield Finding("rows", "", verdict, f"{what} (seed {seed})", (whole - count) / whole)


def _differing_rows(folder: RunFolder, shard: Shard, files: ShardFiles) -> Iterator[Finding]:
    """Where the rows of a shard differ from those of a new simulation."""
    for kind in KINDS:
        where = f"{kind}/{shard.name}.parquet"
        again = pl.read_parquet(BytesIO(files[kind]))
        try:
            if folder.content(kind, shard) == files[kind]:
                continue
            stored = folder.read_unchecked(kind, shard)
        except RunFolderError as error:
            yield Finding("rows", where, "fail", str(error))
            continue
        what = "the rows are the same, but the file has other bytes, such as more columns"
        yield Finding("rows", where, "fail", first_difference(stored, again) or what)


def first_difference(stored: pl.DataFrame, again: pl.DataFrame) -> str:
    """Says where rows first differ from those of a new simulation; empty if nowhere."""
    if len(stored) != len(again):
        return f"has {counted(len(stored), 'row')}; simulated again, {len(again):,}"
    # On the straight road, rows are written without the columns of the others.
    again = pl.concat([stored.clear(), again], how="diagonal").select(stored.columns)
    unequal = pl.DataFrame([~stored[name].eq_missing(again[name]) for name in stored.columns])
    wrong = unequal.select(pl.any_horizontal("*")).to_series().arg_true()
    if not len(wrong):
        return ""
    row = wrong[0]
    column = next(name for name in stored.columns if unequal[name][row])
    known = "episode", "ego_index", "step", "agent", "quantity", "bin"
    keys = [name for name in known if name in again]
    place = ", ".join(f"{name} {again[name][row]}" for name in keys if name != column)
    others = f", and {len(wrong) - 1} more rows differ" if len(wrong) > 1 else ""
    return (
        f"row {row + 1} ({place}): {column} is {stored[column][row]}; simulated again, "
        f"{again[column][row]}{others}"
    )


def audit_rare(folder: Path) -> Iterator[Finding]:
    """Yields what is found about the files of an estimation of a rare event."""
    damaged = damaged_files(folder)
    for path in damaged:
        where = str(path.relative_to(folder))
        yield Finding("files", where, "fail", "does not match the hash in it")
    if not damaged:
        yield Finding("files", "", "pass", "the files of all runs match the hashes in them")
    what = (
        "are not simulated again; run `charms-bench rare` with the same suite, event, samples and "
        "seed into another folder, and compare the tables"
    )
    yield Finding("rows", "", "unknown", what)
