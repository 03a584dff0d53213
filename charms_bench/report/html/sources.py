"""Opens the run folders that a report is made of: evaluations and trainings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

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


@dataclass(frozen=True)
class Evaluation:
    """The folder of a finished run of a suite."""

    key: str
    """Its name in the report's links: the suite's, with a number if it is taken."""
    path: Path
    run: FinishedRun
    tables: RunTables


@dataclass(frozen=True)
class TrainingFolder:
    """The folder of a training."""

    key: str
    """Its name in the report's links: `training`, with a number if it is taken."""
    path: Path
    training: Training


@dataclass(frozen=True)
class TableFolder:
    """The folder of `rare` or `search`, which has one table."""

    key: str
    """Its name in the report's links, with a number if it is taken."""
    path: Path
    table: Table


Source = Evaluation | TrainingFolder | TableFolder


def open_sources(paths: Sequence[Path]) -> list[Source]:
    """The run folders, in this order.

    Raises:
        RunFolderError: One is not a run folder, is not finished, is damaged, or is given twice.
    """
    sources: list[Source] = []
    for path in map(absolute, paths):
        if path.resolve() in {source.path.resolve() for source in sources}:
            raise RunFolderError(f"{path}: is given twice")
        keys = {source.key for source in sources}
        if holds(path, RARE):
            sources.append(TableFolder(unused("rare", keys), path, stored_rare(path)))
            continue
        if holds(path, SEARCH):
            sources.append(TableFolder(unused("search", keys), path, _failures(path)))
            continue
        run = open_finished(path) if holds(path, MANIFEST) else None
        if run is None and not holds(path, CURVES):
            raise RunFolderError(
                f"{path}: holds neither an evaluation ({MANIFEST}) nor a training ({CURVES}); "
                "`charms-bench run` makes both, `rare` and `search` other folders that reports take"
            )
        name = "training" if run is None else run.suite.suite
        key = unused(name, keys)
        if run is None:
            sources.append(TrainingFolder(key, path, stored_training(path)))
        else:
            sources.append(Evaluation(key, path, run, stored_tables(path, run.suite)))
    return sources


def _failures(folder: Path) -> Table:
    """The failures that a search has found."""
    points = found_in(folder)
    records = [{"failure": str(number), **point} for number, point in enumerate(points)]
    columns = tuple(Column(name, form=".3f") for name in (points[0] if points else ()))
    title = f"Failures of a search: {folder.name}"
    note = "" if points else "No failure was found."
    return Table.from_records(records, "failures", title, ("failure",), columns, note)
