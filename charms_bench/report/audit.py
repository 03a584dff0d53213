"""What an audit has found; and the tables of a run, computed again from its rows."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import polars as pl

from charms_bench.errors import CharmsBenchError, RegistryError, RunFolderError
from charms_bench.foundation.files import is_compressed, read_file
from charms_bench.foundation.words import counted
from charms_bench.humans.reference import Reference, read_references
from charms_bench.metrics import SCENARIOS, MetricSet
from charms_bench.report import run_files
from charms_bench.report.stored import SUMS, TABLE_LIMIT_BYTES, read_table
from charms_bench.report.suite_table import KEYS, LONG, matrices
from charms_bench.report.table import Column, Row, Table, long_schema
from charms_bench.runs.audit_finding import VERDICTS, Finding, Verdict
from charms_bench.runs.code_hashes import module_blobs, row_modules
from charms_bench.runs.finished_run import open_finished
from charms_bench.runs.metric_sets import asked_by, metric_sets
from charms_bench.runs.suite import Suite


def audit_tables(folder: Path, suite: Suite) -> Iterator[Finding]:
    """Yields where the files in `tables` differ from what the rows in the folder give.

    The table of a run with other code may differ for that reason, which is `unknown`.

    The folder is a run's, and the suite names the folder that paths of recordings start from.
    """
    sets: Sequence[MetricSet] = suite.metric_sets
    unknown, references = set[str](), list[Reference]()
    try:
        run = open_finished(folder)
        try:
            references = read_references(suite.references, suite.folder)
        except CharmsBenchError as error:
            yield Finding("tables", f"tables/{suite.suite}-realism.csv", "unknown", str(error))
        try:
            sets = _stored_sets(folder / "tables" / f"{suite.suite}.csv", suite)
        except RegistryError as error:  # metrics of a plugin that is not installed
            unknown = {f"{suite.suite}.csv", f"{suite.suite}.md"}
            yield Finding("tables", f"tables/{suite.suite}.csv", "unknown", str(error))
        except RunFolderError:
            pass  # it is compared as a file
        run = replace(run, leaves_out=any(each.name == SCENARIOS.name for each in sets))
        following = run.following() if references else []
        cells = [run_files.measure(suite, rows, sets) for rows in run.cells()]
        made = run_files.run_tables(suite, cells, following, references, sets)
    except CharmsBenchError as error:
        yield Finding("tables", "", "unknown", f"cannot be computed again: {error}")
        return
    recorded, blobs = run.folder.manifest().get("modules", {}), module_blobs()
    deciding = row_modules(entry=run_files.__name__)
    is_own = all(recorded.get(name) == blobs[name] for name in deciding)
    expected: dict[str, bytes] = {}
    for table, introduction in made:
        expected |= run_files.table_files(table, introduction)
    if matrix := matrices(made[0][0]):
        expected[f"{suite.suite}-matrix.md"] = run_files.matrix_page(matrix)
    found: list[Finding] = []
    wrong: Verdict = "fail" if is_own else "unknown"
    for name, data in expected.items():
        if name not in unknown and (what := _difference(folder / "tables" / name, data)):
            found.append(Finding("tables", f"tables/{name}", wrong, what))
    if suite.references:
        unknown |= {f"{suite.suite}-realism.{kind}" for kind in ("csv", "md")}
    for path in sorted((folder / "tables").glob("*")):
        if path.name not in {*expected, *unknown, SUMS}:
            is_suites = re.fullmatch(rf"{suite.suite}(-[a-z]+)?\.(csv|md)", path.name)
            what = "is not a table of this suite"
            verdict: Verdict = wrong if is_suites else "fail"
            found.append(Finding("tables", f"tables/{path.name}", verdict, what))
    same = f"{len(expected)} files, computed again from the rows in the folder, are the same"
    yield from found or [Finding("tables", "", "pass", same)]


def _stored_sets(path: Path, suite: Suite) -> Sequence[MetricSet]:
    """The metric sets that a table was computed with, which `rescore` may have chosen."""
    read = partial(read_file, limit=TABLE_LIMIT_BYTES)  # also where somebody has changed it
    table = read_table(path, long_schema(suite.with_road(KEYS), LONG), read)
    labels = table["metric_set"].unique(maintain_order=True)
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
        found = read_file(path, TABLE_LIMIT_BYTES)
    except RunFolderError as error:
        return str(error)
    if found == expected:
        return ""
    if path.suffix == ".csv" and (what := _differing_number(found, expected)):
        return what
    lines = found.decode(errors="replace").splitlines()
    wanted = expected.decode().splitlines()
    pairs = zip([*lines, ""], [*wanted, ""], strict=False)
    for number, (is_now, should_be) in enumerate(pairs, start=1):
        if is_now != should_be:
            return f"line {number} is '{is_now[:200]}'; computed again, '{should_be[:200]}'"
    return "has other line endings, or other bytes that are not text"


def _differing_number(found: bytes, expected: bytes) -> str:
    """Says which number of a CSV file first differs; empty if its columns or rows are others."""
    if is_compressed(found):
        return ""
    try:
        stored, again = (pl.read_csv(each, infer_schema=False) for each in (found, expected))
    except pl.exceptions.PolarsError:
        return ""
    if stored.columns != again.columns or len(stored) != len(again):
        return ""
    # The columns before the numbers say what a row is about.
    keys = again.columns[: again.columns.index("value")] if "value" in again.columns else []
    for one, other in zip(stored.iter_rows(named=True), again.iter_rows(named=True), strict=True):
        for column in stored.columns:
            if one[column] != other[column]:
                labels = ", ".join(str(other[name]) for name in keys)
                is_now, should_be = (str(each[column] or "empty")[:200] for each in (one, other))
                return f"{labels}: {column} is {is_now}; computed again, {should_be}"
    return ""


FINDINGS = 20
"""Findings in the text of an audit."""


@dataclass(frozen=True)
class Audit:
    """What an audit of a run folder has found."""

    path: Path
    """The folder."""
    findings: tuple[Finding, ...]
    """What each check found; several for a check that found several problems."""

    def __repr__(self) -> str:
        return f"<Audit of {self.path}: {self.verdict}, {counted(len(self.findings), 'finding')}>"

    def __str__(self) -> str:
        more = [f"{len(self.findings) - FINDINGS} more findings"][: len(self.findings) > FINDINGS]
        return "\n".join([repr(self), *self.lines()[:FINDINGS], *more])

    def lines(self) -> list[str]:
        """A line for each finding."""
        return [
            f"{each.verdict:<9}{each.check:<10}{f'{each.where}: ' if each.where else ''}{each.what}"
            for each in self.findings
        ]

    def _repr_html_(self) -> str:
        return self.table._repr_html_()

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of a finding."""
        return max((each.verdict for each in self.findings), key=VERDICTS.index, default="unknown")

    @property
    def undrawn(self) -> float:
        """Probability that none of the shards simulated again is false, if one shard is false."""
        return max((each.undrawn for each in self.findings), default=0.0)

    @property
    def table(self) -> Table:
        """One row per finding."""
        rows = [Row((each.check, each.where), (each.verdict, each.what)) for each in self.findings]
        columns = (Column("verdict"), Column("found"))
        return Table("audit", "Audit", ("check", "where"), columns, tuple(rows))
