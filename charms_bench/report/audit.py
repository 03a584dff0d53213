"""What an audit has found; and the tables of a run, computed again from its rows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from charms_bench.errors import CharmsBenchError, RunFolderError
from charms_bench.metrics import MetricSet
from charms_bench.people.reference import read_references
from charms_bench.report import run_files
from charms_bench.report.stored import read_table
from charms_bench.report.suite_table import KEYS, LONG, matrices
from charms_bench.report.table import Column, Row, Table, long_schema
from charms_bench.runs.audit import VERDICTS, Finding, Verdict
from charms_bench.runs.code_hashes import module_blobs, row_modules
from charms_bench.runs.finished import FinishedRun, open_finished
from charms_bench.runs.folder import FILE_LIMIT_BYTES
from charms_bench.runs.metric_sets import asked_by, metric_sets
from charms_bench.runs.suite import Suite
from charms_bench.world.files import read_file


def audit_tables(folder: Path, suite: Suite) -> Iterator[Finding]:
    """Yields where the files in `tables` differ from what the rows in the folder give.

    Args:
        folder: The run folder.
        suite: Its suite, with the folder that relative paths of recordings start from.
    """
    try:
        run = open_finished(folder)
    except RunFolderError as error:
        yield Finding("tables", "", "unknown", f"cannot be computed again: {error}")
        return
    wrong: Verdict = "unknown" if _has_other_code(run) else "false"
    try:
        references = read_references(suite.references, suite.folder)
    except CharmsBenchError as error:
        references = []
        yield Finding("tables", f"tables/{suite.suite}-realism.csv", "unknown", str(error))
    try:
        sets = _stored_sets(folder / "tables" / f"{suite.suite}.csv")
        following = run.following() if references else []
        cells = [run_files.measure(suite, rows, sets) for rows in run.cells()]
        made = run_files.run_tables(suite, cells, following, references, sets)
    except CharmsBenchError as error:
        yield Finding("tables", "", "unknown", f"cannot be computed again: {error}")
        return
    expected: dict[str, bytes] = {}
    for table, introduction in made:
        expected |= run_files.table_files(table, introduction)
    if matrix := matrices(made[0][0]):
        expected[f"{suite.suite}-matrix.md"] = run_files.matrix_page(matrix)
    count = 0
    for name, data in expected.items():
        if what := _difference(folder / "tables" / name, data):
            count += 1
            yield Finding("tables", f"tables/{name}", wrong, what)
    unknown = (
        {f"{suite.suite}-realism.{kind}" for kind in ("csv", "md")} if suite.references else {}
    )
    for path in sorted((folder / "tables").glob("*")):
        if path.name not in expected and path.name not in unknown:
            count += 1
            yield Finding("tables", f"tables/{path.name}", "false", "is not a table of this suite")
    if not count:
        what = f"{len(expected)} files, computed again from the rows in the folder, are the same"
        yield Finding("tables", "", "true", what)


def _has_other_code(run: FinishedRun) -> bool:
    recorded, blobs = run.folder.manifest().get("modules"), module_blobs()
    deciding = row_modules(entry=run_files.__name__)
    return not isinstance(recorded, dict) or any(
        recorded.get(name) != blobs[name] for name in deciding
    )


def _stored_sets(path: Path) -> Sequence[MetricSet]:
    """The metric sets that a table was computed with, which `rescore` may have chosen."""
    labels = read_table(path, long_schema(KEYS, LONG))["metric_set"].unique(maintain_order=True)
    texts = []
    for label in labels:
        text = asked_by(label or "")
        if text is None:
            raise RunFolderError(f"{path}: no metric set is labelled '{label}'")
        texts.append(text)
    return metric_sets(texts)


def _difference(path: Path, expected: bytes) -> str:
    """Says where a file first differs; empty if it does not."""
    try:
        found = read_file(path, FILE_LIMIT_BYTES)
    except RunFolderError as error:
        return str(error)
    if found == expected:
        return ""
    if path.suffix == ".csv" and (what := _differing_number(found, expected)):
        return what
    lines = found.decode(errors="replace").splitlines()
    wanted = expected.decode().splitlines()
    pairs = zip([*lines, ""], [*wanted, ""], strict=False)
    number, (is_now, should_be) = next(
        (k, pair) for k, pair in enumerate(pairs, start=1) if pair[0] != pair[1]
    )
    return f"line {number} is '{is_now[:200]}'; computed again, '{should_be[:200]}'"


def _differing_number(found: bytes, expected: bytes) -> str:
    """Says which number of a CSV file first differs; empty if its rows are others."""
    try:
        tables = [pl.read_csv(each, infer_schema=False) for each in (found, expected)]
    except pl.exceptions.PolarsError:
        return ""
    stored, again = tables
    if stored.columns != again.columns or len(stored) != len(again):
        return ""
    # The columns before the numbers say what a row is about.
    keys = again.columns[: again.columns.index("value")] if "value" in again.columns else []
    for one, other in zip(stored.iter_rows(named=True), again.iter_rows(named=True), strict=True):
        for column in stored.columns:
            if one[column] != other[column]:
                labels = ", ".join(str(other[name]) for name in keys)
                return (
                    f"{labels}: {column} is {one[column] or 'empty'}; computed again, "
                    f"{other[column] or 'empty'}"
                )
    return ""


@dataclass(frozen=True)
class Audit:
    """What an audit of a run folder has found."""

    path: Path
    """The folder."""
    findings: tuple[Finding, ...]
    """What each check found; several for a check that found several problems."""

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of a finding."""
        return max((each.verdict for each in self.findings), key=VERDICTS.index, default="unknown")

    @property
    def table(self) -> Table:
        """One row per finding."""
        rows = [Row((each.check, each.where), (each.verdict, each.what)) for each in self.findings]
        columns = (Column("verdict"), Column("found"))
        return Table("audit", "Audit", ("check", "where"), columns, tuple(rows))
