"""Opens the run folders that a report is made of: evaluations and trainings."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from charms_bench.episodes.found_suite import found_in
from charms_bench.episodes.search import MANIFEST as SEARCH
from charms_bench.errors import RunFolderError
from charms_bench.foundation.files import absolute
from charms_bench.foundation.names import unused
from charms_bench.report.rare_table import stored_rare
from charms_bench.report.stored import RunTables, holds, stored_tables
from charms_bench.report.table import Column, Table
from charms_bench.report.training_tables import CURVES, Training, stored_training
from charms_bench.runs.finished_run import FinishedRun, open_finished
from charms_bench.runs.rare import MANIFEST as RARE
from charms_bench.runs.resumable_folder import MANIFEST


class Evaluation(NamedTuple):
    """The folder of a finished run of a suite."""

    key: str
    """Its name in the report's links, such as the suite's, with a number if it is taken."""
    path: Path
    run: FinishedRun
    tables: RunTables


class OtherFolder(NamedTuple):
    """The folder of a training, or that of `rare` or `search`, which has one table."""

    key: str
    path: Path
    found: Training | Table


Source = Evaluation | OtherFolder


def open_sources(paths: Sequence[Path]) -> list[Source]:
    """The run folders, in this order.

    A `RunFolderError` if one is no run folder, is not finished, is damaged, or is given twice.
    """
    sources: list[Source] = []
    for path in map(absolute, paths):
        if path.resolve() in {source.path.resolve() for source in sources}:
            raise RunFolderError(f"{path}: is given twice")
        sources.append(_opened(path, {source.key for source in sources}))
    return sources


def _opened(path: Path, keys: set[str]) -> Source:
    if holds(path, RARE):
        return OtherFolder(unused("rare", keys), path, stored_rare(path))
    if holds(path, SEARCH):
        return OtherFolder(unused("search", keys), path, _failures(path))
    if holds(path, MANIFEST):
        run = open_finished(path)
        run.folder.reject_damaged(run.shards)
        return Evaluation(unused(run.suite.suite, keys), path, run, stored_tables(path, run.suite))
    if holds(path, CURVES):
        return OtherFolder(unused("training", keys), path, stored_training(path))
    raise RunFolderError(
        f"{path}: holds neither an evaluation ({MANIFEST}) nor a training ({CURVES}); "
        "`charms-bench run` makes both, `rare` and `search` other folders that reports take"
    )


def _failures(folder: Path) -> Table:
    """The failures that a search has found."""
    points = found_in(folder)
    records = [{"failure": str(number), **point} for number, point in enumerate(points)]
    columns = tuple(Column(name, form=".5g") for name in (points[0] if points else ()))
    title = f"Failures of a search: {folder.name}"
    note = "" if points else "No failure was found."
    return Table.from_records(records, "failures", title, ("failure",), columns, note)
