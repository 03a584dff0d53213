"""The tables of docs/reproduction.md: the paper, its authors' networks, and this project's.

`write_results.py` writes what `compared` and `with_verdicts` return to a CSV file, and makes a
page's table of it with `side_by_side`.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.stored import stored_tables
from charms_bench.report.table import Column, Table
from charms_bench.runs.resumable_folder import RunFolder

METRICS = {
    "collision_rate": "collision rate",
    "interaction_density": "interaction density",
    "ttc_below_3s": "TTC < 3 s",
    "ttc_below_3s_closing": "TTC < 3 s, closing",
    "speed_mean": "speed, m/s",
    "speed_std": "speed std, m/s",
    "acc_mean": "acceleration, m/s²",
    "acc_std": "acceleration std, m/s²",
    "yaw_std": "yaw std, rad",
    "dhw_mean": "headway, m",
    "dhw_std": "headway std, m",
    "harsh_acc_rate": "harsh",
    "harsh_acc_rate_all_steps": "harsh, all decisions",
    "crashed_episodes": "episodes crashed, %",
    "traffic_crashed": "vehicles crashed in 20 s, %",
}
"""What the tables call each metric, in the order of their columns."""
CRASHED = ("crashed_episodes", "traffic_crashed")
"""Metrics that the paper does not report."""
Z_95 = 1.96
"""Standard errors from a value to the ends of its 95 % interval."""
SOURCES = {"released": "authors' networks", "ours": "this project"}
"""The columns of values, by the beginning of the names of their columns in the CSV file."""
BY_PAPER = " by the paper"
"""The label of an agent by the paper's settings, which stands for the one with the other label."""


def compared(released: Path, ours: Path) -> pl.DataFrame:
    """The results of a suite with the authors' networks and of the same suite with this project's.

    One row per agent, or per traffic if the suite varies the traffic, and metric: those that the
    paper reports, and the proportion that crashed. A `ValueError` if the two runs differ in more
    than the last decision, which only the authors' code makes.
    """
    suites = [RunFolder(run).suite() for run in (released, ours)]
    # The authors' code has episodes of 61 decisions.
    profile = suites[1].scene.profile.model_copy(update={"sums_time": True})
    if suites[0].scene != suites[1].scene.model_copy(update={"profile": profile}):
        raise ValueError(f"{released} and {ours} have different scenes; run both suites again")
    varied = "agent" if len(suites[0].egos) > 1 else "traffic"
    crashed = {"agent": "crashed_episodes", "traffic": "traffic_crashed"}[varied]
    is_crashed = pl.col("metric_set").str.starts_with("standard-") & (pl.col("metric") == crashed)
    frames = [
        stored_tables(run, suite)
        .metrics.frame()
        .filter(pl.col("paper").is_not_null() | is_crashed)
        .select(varied, "metric", "paper", pl.col("value", "low", "high").name.prefix(f"{source}_"))
        for run, suite, source in zip((released, ours), suites, SOURCES, strict=True)
    ]
    by_paper = frames[1].filter(pl.col(varied).str.ends_with(BY_PAPER))
    renamed = by_paper.with_columns(pl.col(varied).str.strip_suffix(BY_PAPER))
    others = frames[1].join(renamed, on=varied, how="anti")
    made = pl.concat([others, renamed]).drop("paper")
    both = frames[0].join(made, on=[varied, "metric"], how="left")
    orders = {varied: list(dict.fromkeys(frames[0][varied])), "metric": list(METRICS)}
    return both.sort(
        pl.col(column).replace_strict(order, range(len(order))) for column, order in orders.items()
    )


def with_verdicts(rows: pl.DataFrame) -> pl.DataFrame:
    """The rows of `compared` with a verdict on the values of each source.

    The paper's values are means over 1,800 episodes, as these are, so that both have sampling
    errors. A value agrees if it differs from the paper's by no more than two such samples do in
    95 % of cases: by at most sqrt(2) times its interval's reach in the direction of the paper's
    value, and half a unit of the last digit that the paper gives for the metric. The difference of
    any other value is given in standard errors of the difference.
    """
    digits = _digits(rows)
    found = [
        {
            f"{source}_agrees": _verdict(row, source, digits[row["metric"]])
            for source in SOURCES
            if row["paper"] is not None
        }
        for row in rows.iter_rows(named=True)
    ]
    schema = {f"{source}_agrees": pl.String for source in SOURCES}
    return rows.hstack(pl.DataFrame(found, schema=schema))


def side_by_side(rows: pl.DataFrame) -> str:
    """The rows of `with_verdicts` as a table, and how many values agree with the paper's.

    An agent or a traffic model has three rows, the paper's and one for each source, and a metric
    has a column. Values that agree with the paper's are marked.
    """
    varied, digits = rows.columns[0], _digits(rows)
    metrics = [metric for metric in METRICS if metric in set(rows["metric"])]
    forms = {metric: ".1f" if metric in CRASHED else f".{digits[metric]}f" for metric in metrics}
    records = []
    for (name,), part in rows.group_by(varied, maintain_order=True):
        found = {row["metric"]: row for row in part.iter_rows(named=True)}
        for source, title in {"paper": "paper", **SOURCES}.items():
            record: dict[str, Any] = {varied: name, "source": title}
            record |= {metric: _number(row, source) for metric, row in found.items()}
            if any(record[metric].value is not None for metric in found):
                records.append(record)
    columns = tuple(Column(metric, form=form) for metric, form in forms.items())
    table = Table.from_records(records, "", "", (varied, "source"), columns)
    shown = table.named(*(METRICS[metric] for metric in metrics))
    counts = []
    for source in SOURCES:
        verdicts = rows[f"{source}_agrees"].drop_nulls().to_list()
        counts.append(f"{verdicts.count('yes')} of {len(verdicts)}")
    return (
        f"{markdown(shown)}\nOf the values of the authors' networks, {counts[0]} agree with the "
        f"paper; of this project's, {counts[1]}.\n"
    )


def _digits(rows: pl.DataFrame) -> dict[str, int]:
    """The digits after the point that the paper gives for each metric."""
    return {
        metric: max(len(f"{value:g}".partition(".")[2]) for value in part["paper"])
        for (metric,), part in rows.drop_nulls("paper").group_by("metric")
    }


def _number(row: Mapping[str, Any], source: str) -> Number:
    """A value, marked if it agrees with the paper's; proportions that crashed are in percent."""
    value = row["paper"] if source == "paper" else row[f"{source}_value"]
    factor = 100.0 if row["metric"] in CRASHED else 1.0
    agrees = source != "paper" and row[f"{source}_agrees"] == "yes"
    return Number(None if value is None else value * factor, marked=agrees)


def _verdict(row: Mapping[str, Any], source: str, digits: int) -> str | None:
    value, low, high = (row[f"{source}_{part}"] for part in ("value", "low", "high"))
    if value is None:
        return None
    difference = max(abs(row["paper"] - value) - 0.5 * 10**-digits, 0.0)
    reach = 0.0 if low is None else high - value if row["paper"] > value else value - low
    if difference <= math.sqrt(2) * reach:
        return "yes"
    return f"no, {difference / (math.sqrt(2) * reach / Z_95):.1f}" if reach else "no"
