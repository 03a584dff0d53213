"""Checks whether the contents of a run folder are correct."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from charms_bench.api.arguments import PathLike, check_positive
from charms_bench.api.warming import warm_up
from charms_bench.errors import RunFolderError
from charms_bench.foundation.files import absolute
from charms_bench.foundation.progress import note, progress
from charms_bench.runs.resumable_folder import MANIFEST

if TYPE_CHECKING:
    from charms_bench.report.audit import Audit


def audit(
    path: PathLike,
    *,
    shards: int | None = 10,
    seed: int | None = None,
    workers: int | None = None,
    suite_folder: PathLike = ".",
    notice: Callable[[str], None] = note,
) -> "Audit":
    """Checks whether the contents of a run folder are correct, and changes nothing.

    It compares the software, files, networks, rows and tables in the folder with the manifest, with
    a new simulation of some shards, and with tables computed from the rows.

    Args:
        path: The folder of an evaluation. Of other folders, it checks what it can.
        shards: How many shards to simulate again; None is all. If one in ten is false, 10 find it
            in 65 of 100 audits.
        seed: Chooses the shards; by default, each audit draws a new seed.
        workers: Processes; by default one per core.
        suite_folder: Where relative paths in the suite start.
        notice: Called with messages about problems that were solved, such as a worker that died.

    Raises:
        RunFolderError: The folder holds no run, or its manifest is damaged.
        CharmsBenchError: A shard cannot be simulated.
    """
    from charms_bench.report.audit import Audit, audit_tables
    from charms_bench.report.stored import holds
    from charms_bench.runs.audit import audit_rare, audit_run
    from charms_bench.runs.rare import MANIFEST as RARE
    from charms_bench.runs.resumable_folder import CHECKSUMS, RunFolder

    check_positive(shards=shards, workers=workers)
    path, suite_folder = absolute(path), absolute(suite_folder)
    if not holds(path, MANIFEST):
        if holds(path, RARE):
            return Audit(path, tuple(audit_rare(path)))
        raise RunFolderError(
            f"{path}: holds no evaluation ({MANIFEST}); a training is checked by training it again"
        )
    folder = RunFolder(path)
    suite = folder.suite().model_copy(update={"folder": suite_folder})
    # Before the agents of the run are imported, which could change how tables are computed.
    tables = list(audit_tables(path, suite))
    warm_up()
    count = len(list((path / CHECKSUMS).glob("*.sha256")))
    with progress("shards", min(shards or count, count) or 1) as tell:
        found = audit_run(folder, suite, shards, seed, workers, tell, notice)
        return Audit(path, (*found, *tables))
