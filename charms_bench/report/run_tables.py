"""The tables of a run: which ones its suite calls for."""

from collections.abc import Sequence
from dataclasses import dataclass

from charms_bench.metrics import METRIC_SETS, MetricSet
from charms_bench.people.reference import Reference
from charms_bench.report.pairs_table import pairs_table
from charms_bench.report.realism_table import realism_table
from charms_bench.report.suite_table import suite_table
from charms_bench.report.table import Table
from charms_bench.runs.cells import CellRows, TrafficCounts
from charms_bench.runs.suite import Suite


@dataclass(frozen=True)
class RunTables:
    """The tables of a run; None for those that its suite does not call for."""

    metrics: Table
    """Every metric of every cell."""
    pairs: Table | None = None
    """The differences between each two egos."""
    realism: Table | None = None
    """How far each traffic is from human driving."""

    def each(self) -> list[Table]:
        """The tables that there are."""
        return [table for table in (self.metrics, self.realism, self.pairs) if table is not None]


def run_tables(
    suite: Suite,
    cells: Sequence[CellRows],
    following: Sequence[TrafficCounts] = (),
    references: Sequence[Reference] = (),
    metric_sets: Sequence[MetricSet] = METRIC_SETS,
) -> RunTables:
    """Computes the tables of a run from its rows.

    Args:
        suite: The suite that was run.
        cells: The rows of its cells.
        following: What all vehicles of its cells did while they followed; for realism.
        references: Human driving to compare with; for realism.
        metric_sets: What to compute of every cell.
    """
    return RunTables(
        metrics=suite_table(suite, cells, metric_sets),
        pairs=pairs_table(suite, cells) if suite.pairs else None,
        realism=realism_table(suite, following, references) if references else None,
    )
