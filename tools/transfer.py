"""How the egos of `suites/ego.yaml` do out of what they were trained in, for `write_results.py`.

The conditions are the traffics of the run folders `transfer-*` and `released-transfer`: drivers
with other parameters, learned drivers, other densities and other numbers of lanes.
"""

from dataclasses import replace
from pathlib import Path

from charms_bench.report.markdown import markdown
from charms_bench.report.stored import stored_tables
from charms_bench.report.table import Column, Number, Row, Table
from charms_bench.runs.folder import RunFolder

METRIC = "crashed_episodes"
CONDITIONS = {
    "transfer-traffics": "",
    "released-transfer": "the authors' ",
    "transfer-density-0-7": "density 0.7",
    "transfer-density-1-5": "density 1.5",
    "transfer-density-2-0": "density 2",
    "transfer-lanes-2": "2 lanes",
    "transfer-lanes-4": "4 lanes",
    "transfer-lanes-5": "5 lanes",
}
"""Names of run folders. One with several traffics gives a condition for each, after this prefix."""


def crashed_elsewhere(runs: Path) -> dict[str, dict[str, Number]]:
    """The share of crashed episodes by condition and ego."""
    found: dict[str, dict[str, Number]] = {}
    for name, said in CONDITIONS.items():
        if not (runs / name).is_dir():
            continue
        table = stored_tables(runs / name, RunFolder(runs / name).suite()).metrics
        place = [column.name for column in table.columns].index(METRIC)
        several = len({row.labels[1] for row in table.rows}) > 1
        for row in table.rows:
            condition = said + row.labels[1] if several else said
            found.setdefault(condition, {})[row.labels[0]] = row.numbers[place]
    return found


def transfer_table(run: Path) -> str:
    """A condition per row and an ego per column, as Markdown."""
    found = crashed_elsewhere(run.parent)
    egos = list(dict.fromkeys(ego for numbers in found.values() for ego in numbers))
    columns = tuple(Column(ego, form=".1%") for ego in egos)
    rows = tuple(
        Row((condition,), tuple(numbers.get(ego, Number()) for ego in egos))
        for condition, numbers in found.items()
    )
    return markdown(Table("transfer", "", ("condition",), columns, rows))


def with_worst(table: Table, runs: Path) -> Table:
    """The table of egos with their largest share of crashed episodes in any condition."""
    conditions = crashed_elsewhere(runs).values()
    rows = []
    for row in table.rows:
        shares = [numbers[row.labels[0]] for numbers in conditions if row.labels[0] in numbers]
        worst = max(shares, key=lambda number: number.value or 0.0, default=Number())
        rows.append(Row(row.labels, (row.numbers[0], worst, *row.numbers[1:])))
    column = Column("crashed in the worst of other conditions", form=".1%")
    columns = (table.columns[0], column, *table.columns[1:])
    return replace(table, columns=columns, rows=tuple(rows))
