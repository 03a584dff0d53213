"""What a report is made of: the folders of evaluations and of trainings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from charms_bench.errors import RunFolderError
from charms_bench.report.stored import holds, stored_tables
from charms_bench.report.training import CURVES, STAGES, stored_training
from charms_bench.runs.finished import FinishedRun, open_finished
from charms_bench.runs.folder import MANIFEST


@dataclass(frozen=True)
class Evaluation:
    """A finished run of a suite."""

    key: str
    """What it is called in the report's links: the suite's name, numbered if it is there twice."""
    path: Path
    run: FinishedRun
    tables: dict[str, pl.DataFrame]
    """By the ends of their names, as `stored_tables` has them."""


@dataclass(frozen=True)
class Training:
    """A run folder of a pipeline, of which no more is known than the two tables in it."""

    key: str
    path: Path
    curves: pl.DataFrame
    """A row a `stage` and point, with `steps` or `epoch` and what was measured there."""
    stages: pl.DataFrame | None
    """A row a `stage`."""


def open_sources(paths: Sequence[Path]) -> list[Evaluation | Training]:
    """The run folders, in this order.

    Raises:
        RunFolderError: One is no run folder, is not finished or is damaged, or stands here twice.
    """
    sources: list[Evaluation | Training] = []
    for path in paths:
        if path.resolve() in {source.path.resolve() for source in sources}:
            raise RunFolderError(f"{path}: is given twice")
        sources.append(_open(path, [source.key for source in sources]))
    return sources


def _open(path: Path, taken: Sequence[str]) -> Evaluation | Training:
    if holds(path, MANIFEST):
        run = open_finished(path)
        name = run.suite.suite
        tables = stored_tables(path, name)
        return Evaluation(_free(name, taken), path, run, tables)
    if holds(path, CURVES):
        tables = stored_training(path)
        return Training(
            _free("training", taken), path, tables[Path(CURVES).stem], tables.get(Path(STAGES).stem)
        )
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
