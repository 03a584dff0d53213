"""Opens the run folders that a report is made of: evaluations and trainings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from charms_bench.errors import RunFolderError
from charms_bench.report.run_tables import RunTables
from charms_bench.report.stored import holds, stored_tables
from charms_bench.report.training_tables import CURVES, Training, stored_training
from charms_bench.runs.finished import FinishedRun, open_finished
from charms_bench.runs.folder import MANIFEST


@dataclass(frozen=True)
class Source:
    """A run folder of a report."""

    key: str
    """Its name in the report's links: the suite's, with a number if it is taken."""
    path: Path


@dataclass(frozen=True)
class Evaluation(Source):
    """The folder of a finished run of a suite."""

    run: FinishedRun
    tables: RunTables


@dataclass(frozen=True)
class TrainingFolder(Source):
    """The folder of a training."""

    training: Training


def open_sources(paths: Sequence[Path]) -> list[Evaluation | TrainingFolder]:
    """The run folders, in this order.

    Raises:
        RunFolderError: One is not a run folder, is not finished, is damaged, or is given twice.
    """
    sources: list[Evaluation | TrainingFolder] = []
    for path in paths:
        if path.resolve() in {source.path.resolve() for source in sources}:
            raise RunFolderError(f"{path}: is given twice")
        sources.append(_open(path, [source.key for source in sources]))
    return sources


def _open(path: Path, taken: Sequence[str]) -> Evaluation | TrainingFolder:
    if holds(path, MANIFEST):
        run = open_finished(path)
        tables = stored_tables(path, run.suite)
        return Evaluation(_free(run.suite.suite, taken), path, run, tables)
    if holds(path, CURVES):
        return TrainingFolder(_free("training", taken), path, stored_training(path))
    raise RunFolderError(
        f"{path}: holds neither an evaluation ({MANIFEST}) nor a training ({CURVES}); "
        "`charms-bench run` makes both"
    )


def _free(name: str, taken: Sequence[str]) -> str:
    """The name, with a number behind it if it is taken."""
    key, number = name, 1
    while key in taken:
        number += 1
        key = f"{name}-{number}"
    return key
