"""The tables of docs/reproduction.md: the paper, its authors' networks, and this project's.

`write_results.py` writes what `compared` returns to a CSV file and makes a page's table of it with
`verdicts`.
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
from charms_bench.runs.folder import RunFolder
from charms_bench.world.scene import SceneSettings

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
"""What the tables call each metric, in the order of their rows."""
Z_95 = 1.96
"""Standard errors from a value to the ends of its 95 % interval."""
SOURCES = {"released": "authors' networks", "ours": "this project"}
"""The columns of values, by the beginning of the names of their columns in the CSV file."""


def compared(released: Path, ours: Path) -> pl.DataFrame:
    """The results of a suite with the authors' networks and of the same suite with this project's.

    Returns:
        One row per agent, or per traffic if the suite varies the traffic, and metric: those that
        the paper reports, and the share that crashed.

    Raises:
        ValueError: The two runs differ in more than the last decision, which only the authors' code
            makes.
    """
    suites = [RunFolder(run).suite() for run in (released, ours)]
    if suites[0].scene != _with_last_decision(suites[1].scene):
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
    both = frames[0].join(frames[1].drop("paper"), on=[varied, "metric"], how="left")
    orders = {varied: list(dict.fromkeys(frames[0][varied])), "metric": list(METRICS)}
    return both.sort(
        pl.col(column).replace_strict(order, range(len(order))) for column, order in orders.items()
    )


def _with_last_decision(scene: SceneSettings) -> SceneSettings:
    """The scene, with episodes of 61 decisions as in the authors' code."""
    profile = scene.profile.model_copy(update={"sums_time": True})
    return scene.model_copy(update={"profile": profile})


def verdicts(rows: pl.DataFrame) -> str:
    """The rows of `compared` as a table with a verdict on each value, and how many values agree.

    The paper's values are means over 1,800 episodes, as these are, so that both have sampling
    errors. A value agrees if it differs from the paper's by no more than two such samples do in
    95 % of cases: by at most sqrt(2) times its interval's reach in the direction of the paper's
    value, and half a unit of the last digit that the paper gives for the metric. The difference of
    any other value is given in standard errors of the difference.
    """
    varied = rows.columns[0]
    digits = {
        metric: max(len(f"{value:g}".partition(".")[2]) for value in part["paper"])
        for (metric,), part in rows.drop_nulls("paper").group_by("metric")
    }
    records = []
    for row in rows.iter_rows(named=True):
        record: dict[str, Any] = {varied: row[varied], "metric": METRICS[row["metric"]]}
        if row["paper"] is not None:
            record["paper"] = f"{row['paper']:.{digits[row['metric']]}f}"
        for source in SOURCES:
            record[source] = _number(row, source)
            if row["paper"] is not None:
                record[f"{source} agrees"] = _verdict(row, source, digits[row["metric"]])
        records.append(record)
    columns = [Column("paper")]
    for source in SOURCES:
        columns += [Column(source, form="margin"), Column(f"{source} agrees")]
    table = Table.from_records(records, "", "", (varied, "metric"), tuple(columns))
    titles = [title for source in SOURCES.values() for title in (source, "agrees")]
    shown = table.named("paper", *titles)
    counts = []
    for source in SOURCES:
        found = [record.get(f"{source} agrees", "–") for record in records]
        counts.append(f"{found.count('yes')} of {len(found) - found.count('–')} rows")
    return (
        f"{markdown(shown)}\nThe paper's value agrees with that of the authors' networks in "
        f"{counts[0]}, and with that of this project in {counts[1]}.\n"
    )


def _number(row: Mapping[str, Any], source: str) -> Number:
    """A value with its interval; shares that the paper does not report are in percent."""
    found = [row[f"{source}_{part}"] for part in ("value", "low", "high")]
    factor = 1.0 if row["paper"] is not None else 100.0
    return Number(*(None if each is None else each * factor for each in found))


def _verdict(row: Mapping[str, Any], source: str, digits: int) -> str:
    value, low, high = (row[f"{source}_{part}"] for part in ("value", "low", "high"))
    if value is None:
        return "–"
    difference = max(abs(row["paper"] - value) - 0.5 * 10**-digits, 0.0)
    reach = 0.0 if low is None else high - value if row["paper"] > value else value - low
    if difference <= math.sqrt(2) * reach:
        return "yes"
    return f"no, {difference / (math.sqrt(2) * reach / Z_95):.1f}" if reach else "no"
