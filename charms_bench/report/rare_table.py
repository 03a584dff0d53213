"""The table of a rare event: its probability in every cell, with what the estimate cost."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import polars as pl

from charms_bench.errors import RunFolderError
from charms_bench.report.number import Number
from charms_bench.report.stored import read_table
from charms_bench.report.table import LONG, Column, Table, long_schema
from charms_bench.runs.manifest import read_manifest
from charms_bench.runs.rare import MANIFEST, RareCell
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import wilson
from charms_bench.statistics.subset_simulation import interval

Z = 1.959964
"""The normal quantile of a 95 % interval."""
INTERVAL = (
    "Student's t on the logarithm of the mean of the independent runs, with the larger of its "
    "variance and that of a lognormal mean (Cox's method); Wilson's if the pilot has one level"
)
MEANING = (
    "probability: in one episode, with its 95 % interval. episodes: simulated in the pilot and "
    "all runs. plain episodes: what plain simulation would need for an interval as narrow."
)
KEYS = ("agent", "traffic")


def rare_table(
    suite: Suite, name: str, definition: str, samples: int, cells: Sequence[RareCell]
) -> Table:
    """The probability of an event in every cell, from its runs with `samples` per level.

    `name` is the name of its files, and `definition` describes the event.
    """
    records = [
        {
            **_labels(each, suite.with_road(KEYS)),
            "probability": (number := _probability(each, samples)),
            "runs": len(each.runs),
            "levels": len(each.pilot.thresholds),
            "episodes": number.n,
            "plain_episodes": plain_episodes(number),
        }
        for each in cells
    ]
    title = f"{suite.title or suite.suite}: probability that {definition}"
    columns = _columns(f"that {definition}")
    table = _noted(Table.from_records(records, name, title, suite.with_road(KEYS), columns))
    lost = {each.cell.title: [run.probability for run in each.runs].count(0) for each in cells}
    counts = [f"{title}: {n} of {len(cells[0].runs)}" for title, n in lost.items() if n]
    if not counts:
        return table
    more = (
        f" Runs that did not reach the event count as 0 ({'; '.join(counts)}). If these are many, "
        "use more samples per level, unless the ego never has the event."
    )
    return replace(table, note=table.note + more)


def stored_rare(folder: Path) -> Table:
    """The table in the folder of an estimation; a `RunFolderError` if it cannot be used."""
    manifest = read_manifest(folder / MANIFEST)
    paths = sorted((folder / "tables").glob("*.csv"))
    if not paths:
        raise RunFolderError(f"{folder}: is not finished; the same command continues there")
    try:
        event, suite = str(manifest["event"]), manifest["suite"]
        title = str(suite.get("title") or suite["suite"])
    except (AttributeError, KeyError, TypeError) as error:
        raise RunFolderError(f"{folder / MANIFEST}: names no event or no suite") from error
    columns = {column.name: column for column in _columns(f"of the event `{event}`")}
    keys = ("agent", "road", "traffic") if suite.get("roads") else KEYS
    table = Table.from_frame(
        read_table(paths[0], long_schema(keys, LONG)),
        paths[0].stem,
        f"{title}: probability of the event {event}",
        keys,
        LONG,
        lambda _, name: columns.get(name, Column(name)),
    )
    return _noted(table)


def _columns(of: str) -> tuple[Column, ...]:
    """The columns of the table; `of` completes the definition of the probability."""
    return (
        Column(
            "probability",
            definition=f"probability {of} in an episode, by subset simulation "
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


def rare_runs(cells: Sequence[RareCell]) -> pl.DataFrame:
    """One row per independent run of every cell."""
    return pl.DataFrame(
        [
            {
                **_labels(each, KEYS if each.cell.road is None else ("agent", "road", "traffic")),
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


def _labels(cell: RareCell, keys: Sequence[str]) -> dict[str, str]:
    return dict(zip(keys, cell.cell.labels, strict=True))


def plain_episodes(number: Number) -> float | None:
    """Returns how many plain episodes give the same ratio of the interval's ends, roughly."""
    value, low, high = number.value, number.low, number.high
    if not value or not low or not high or high <= low:
        return None
    found = (2 * Z / math.log(high / low)) ** 2 * (1 - value) / value
    return float(f"{found:.1e}")


def _probability(cell: RareCell, samples: int) -> Number:
    low, high = (None if math.isnan(end) else end for end in interval(cell.runs, samples))
    value = sum(run.probability for run in cell.runs) / len(cell.runs)
    return Number(value, low, high, sum(run.evaluations for run in (cell.pilot, *cell.runs)))


def _noted(table: Table) -> Table:
    """The table with a note: how wide its intervals are, and those of as many plain episodes."""
    found, is_wider = [], False
    for row in table.rows:
        title, number = " in ".join(row.labels), row.numbers[0]
        if not number.value or number.n is None or number.low is None or number.high is None:
            continue
        low, high = wilson(number.value * number.n, number.n)
        ratio = number.high / number.low if number.low else math.inf
        is_wider |= ratio > high / low
        found.append(f"{title}, {_two_digits(ratio)} ({_two_digits(high / low)})")
    if not found:
        return replace(table, note=MEANING)
    advice = " Where it is smaller, use more samples per level, or count with `charms-bench run`."
    note = (
        f"{MEANING} Ratio of the interval's ends (in parentheses, that of as many plain episodes): "
        f"{'; '.join(found)}.{advice * is_wider}"
    )
    return replace(table, note=note)


def _two_digits(ratio: float) -> str:
    return f"{float(f'{ratio:.2g}'):,.10g}"
