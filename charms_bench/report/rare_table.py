"""The table of a rare event: its probability in every cell, with what the estimate cost."""

import math
from collections.abc import Sequence

import polars as pl

from charms_bench.report.number import Number
from charms_bench.report.table import Column, Table
from charms_bench.runs.rare import RareCell
from charms_bench.runs.suite import Suite
from charms_bench.statistics.subset_simulation import interval

Z = 1.959964
"""The normal quantile of a 95 % interval."""
INTERVAL = (
    "Student's t on the logarithm of the mean of the independent runs, with the larger of its "
    "variance and that of a lognormal mean (Cox's method); Wilson's if the pilot has one level"
)


def rare_table(
    suite: Suite, name: str, definition: str, samples: int, cells: Sequence[RareCell]
) -> Table:
    """The probability of an event in every cell, from its runs with `samples` per level.

    `name` is that of its files, `definition` says what the event is.
    """
    columns = (
        Column(
            "probability",
            definition=f"probability that {definition} in an episode, by subset simulation "
            "with thresholds from a pilot: mean of the independent runs",
            counted="episodes simulated",
            interval=INTERVAL,
            form=".2e",
        ),
        Column("runs", definition="independent runs of subset simulation", form=",.0f"),
        Column("levels", definition="levels of a run, by the pilot", form=",.0f"),
        Column("episodes", definition="episodes simulated in the pilot and all runs", form=",.0f"),
        Column(
            "plain_episodes",
            definition="episodes that plain simulation would need for an interval as narrow, "
            "relative to the probability",
            form=",.0f",
        ),
    )
    records = []
    for each in cells:
        number = _probability(each, samples)
        records.append(
            {
                "agent": each.cell.ego.title,
                "traffic": each.cell.traffic.title,
                "probability": number,
                "runs": len(each.runs),
                "levels": len(each.pilot.thresholds),
                "episodes": number.n,
                "plain_episodes": plain_episodes(number),
            }
        )
    title = f"{suite.title or suite.suite}: probability that {definition}"
    return Table.from_records(records, name, title, ("agent", "traffic"), columns, _note(cells))


def rare_runs(cells: Sequence[RareCell]) -> pl.DataFrame:
    """One row per independent run of every cell."""
    return pl.DataFrame(
        [
            {
                "agent": each.cell.ego.title,
                "traffic": each.cell.traffic.title,
                "run": number,
                "probability": run.probability,
                "episodes": run.evaluations,
                "thresholds": run.thresholds,
                "shares": run.shares,
                "acceptance": run.acceptance,
            }
            for each in cells
            for number, run in enumerate(each.runs, start=1)
        ]
    )


def plain_episodes(number: Number) -> float | None:
    """Returns how many plain episodes give the same ratio of the interval's ends, roughly."""
    value, low, high = number.value, number.low, number.high
    if not value or not low or not high or high <= low:
        return None
    found = (2 * Z / math.log(high / low)) ** 2 * (1 - value) / value
    return float(f"{found:.1e}")


def _probability(cell: RareCell, samples: int) -> Number:
    low, high = interval(cell.runs, samples)
    value = sum(run.probability for run in cell.runs) / len(cell.runs)
    episodes = sum(run.evaluations for run in (cell.pilot, *cell.runs))
    if math.isnan(low):
        return Number(value, n=episodes)
    return Number(value, low, high, episodes)


def _note(cells: Sequence[RareCell]) -> str:
    """How to read the table, and what to know of runs that have not reached the event."""
    meaning = (
        "probability: in one episode, with its 95 % interval. episodes: simulated in the pilot and "
        "all runs. plain episodes: what plain simulation would need for an interval as narrow."
    )
    lost = [each for each in cells if any(run.probability == 0 for run in each.runs)]
    if not lost:
        return meaning
    which = "; ".join(
        f"{each.cell.title}: {sum(run.probability == 0 for run in each.runs)} of {len(each.runs)}"
        for each in lost
    )
    return (
        f"{meaning} Runs that did not reach the event count as 0 ({which}). If these are many, use "
        "more samples per level, unless the ego never has the event."
    )
