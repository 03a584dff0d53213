"""Remarks about the egos of a run that its tables do not show."""

from itertools import islice

from charms_bench.metrics.missing_lanes import MEANING, missing_lanes
from charms_bench.runs.finished import FinishedRun


def remarks(run: FinishedRun, agent: str | None = None, traffic: str | None = None) -> list[str]:
    """A line about each ego that often commands lanes that do not exist, and what it means.

    The decisions are those of the ego's first cell, or of its first few thousand episodes there.

    Args:
        run: The run.
        agent: Label of an ego; by default all.
        traffic: Label of a traffic; by default the first of each ego.

    Raises:
        RunFolderError: The rows cannot be read.
    """
    first: dict[str, int] = {}
    for index, cell in enumerate(run.suite.cells):
        if agent in (None, cell.ego.title) and traffic in (None, cell.traffic.title):
            first.setdefault(cell.ego.title, index)
    found = []
    for ego, index in first.items():
        rows = run.cell(index)
        steps = (steps for _, steps in islice(rows.parts, 1))
        if said := missing_lanes(steps, run.suite.cells[index].scene.lanes).remark():
            found.append(f"{ego} in {rows.traffic}: {said}")
    return [*found, MEANING] if found else []
