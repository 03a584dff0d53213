"""Records the rows: `python -m rows.record` in `tests/golden`, with the names of some parts.

What is there is kept: only what a commit has deleted, by name and for a reason, is recorded again.
"""

import csv
import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rows import features, reference, training
from rows.cells import PROJECT, SUITES, rows_of

from charms_bench.foundation.workers import in_processes
from charms_bench.testing.exact_maths import worker_environment

DATA = Path(__file__).with_name("data")


def record_suite(name: str, folder: Path) -> None:
    """Writes the rows of a suite, a line for each cell."""
    path = DATA / "suites" / f"{name}.csv"
    if path.exists():
        return
    rows = [*rows_of(name, folder)]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def record_reference(folder: Path) -> None:
    """Writes the hashes of the reference, which takes some minutes."""
    path = DATA / "reference.npz"
    found = dict(np.load(path, allow_pickle=False)) if path.exists() else {}
    missing = {name: case for name, case in reference.cases(folder).items() if name not in found}
    work, environment = reference.through_reference, worker_environment()
    with closing(in_processes(work, missing.items(), 1, environment=environment)) as done:
        found |= {name: hashes for (name, _), hashes in done}
    np.savez_compressed(path, **found)


def record_features(folder: Path) -> None:
    """Writes what features make."""
    _record_json("features", features.CASES, folder)


def record_training(folder: Path) -> None:
    """Writes the hashes of the networks that stages train."""
    _record_json("training", training.CASES, folder)


def _record_json(name: str, cases: Mapping[str, Callable[[Path], Any]], folder: Path) -> None:
    path = DATA / f"{name}.json"
    found = json.loads(path.read_text()) if path.exists() else {}
    for number, (case, values) in enumerate(cases.items()):
        if case not in found:
            (own := folder / str(number)).mkdir()
            found[case] = values(own)
    path.write_text(json.dumps(found, indent=1) + "\n")


PARTS = {
    "features": record_features,
    "reference": record_reference,
    "training": record_training,
}

if __name__ == "__main__":
    os.chdir(PROJECT)
    for name in sys.argv[1:] or (*PARTS, *SUITES):
        with TemporaryDirectory() as made:
            if name in PARTS:
                PARTS[name](Path(made))
            else:
                record_suite(name, Path(made))
