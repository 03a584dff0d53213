"""The tables of docs/training-plan-roads.md, for `write_results.py plan-roads NETWORKS RUNS`.

NETWORKS and RUNS are those of `plan_roads.py`. Tests that are not in RUNS and seeds that are not in
NETWORKS keep their rows.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import plan_roads as plan
import polars as pl
from plan_roads_told import told, told_table
from plan_roads_values import kept, mean_of, rates_of_traffic, traffic_table, trained, values_of
from result_pages import RESULTS, keep
from scipy import stats

import charms_bench
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished
from charms_bench.statistics.paired import holm
from charms_bench.world.scene import Floats

LIMITS = {  # goal reached, at fault
    plan.MERGE: (0.98, 0.005), plan.EXIT: (0.95, 0.01), plan.ROUNDABOUT: (0.92, 0.02),
    "intersection-v1": (0.92, 0.02),
}  # fmt: skip
COLUMNS: dict[str, tuple[str, str, Callable[[Floats], float]]] = {
    "reached": ("goal reached", ".1%", min),
    "at_fault": ("at fault or undecided", ".2%", max),
    "crashed": ("crashed", ".2%", max),
    "time_s": ("mean time, s", ".1f", max),
}
"""Header and format of each metric, and which of the seeds' values is the worst."""
ON_STRAIGHT = {
    "crashed_at_fault": ("crashed at fault", ".2%"),
    "speed_mean": ("speed, m/s", ".2f"),
}
"""Header and format of each metric of the straight road."""
ROUGH = pl.col("conflicts", "time_s", "wrecks", "^imposed.*|lag_gap_m|pet_s$").round_sig_figs(3)
OTHERS, SELF = "prosocial|altruistic", "competitive|egoistic"
STATEMENTS = [  # the styles of the first kind have less of it
    ("efficient styles reach the goal sooner than safe ones, s", "time_s", "^efficient", "^safe"),
    ("safe styles cause fewer conflicts per 1,000 km", "conflicts", "^safe", "^efficient"),
    ("prosocial and altruistic styles impose less braking, m/s²", "imposed_mps2", OTHERS, SELF),
    ("competitive and egoistic styles leave smaller lag gaps, m", "lag_gap_m", SELF, OTHERS),
    ("competitive and egoistic styles have shorter PET, s", "pet_s", SELF, OTHERS),
]


def outcomes(values: pl.DataFrame, key: tuple[str, ...], across: str) -> str:
    """How often the goal is reached and how often the ego is at fault, a column per `across`."""
    records = []
    for labels, row in values.group_by(key, maintain_order=True):
        record = dict(zip(key, labels, strict=True))
        record["seeds"] = str(row["seed"].drop_nulls().n_unique())
        for (label,), cell in row.group_by(across, maintain_order=True):
            means = [mean_of(cell[name].to_numpy(), 0.0, 1.0) for name in ("reached", "at_fault")]
            record[str(label)] = " / ".join(
                percentage(mean, form) for mean, form in zip(means, (".1f", ".2f"), strict=True)
            )
        records.append(record)
    columns = [*key, "seeds", *values[across].unique(maintain_order=True)]
    every = [{name: record.get(name, "") for name in columns} for record in records]
    return markdown(Table.plain(every, key, dict.fromkeys(columns[len(key) :], "")))


def percentage(mean: Number, form: str) -> str:
    """A mean in %, with its interval if there is one."""
    assert mean.value is not None
    if mean.low is None or mean.high is None:
        return f"{100 * mean.value:{form}}"
    return f"{100 * mean.value:{form}} [{100 * mean.low:{form}}, {100 * mean.high:{form}}]"


def statements(values: pl.DataFrame) -> str:
    """What the plan states of styles: differences of means, paired by seed, with Holm's p."""
    records, p = list[dict[str, Any]](), list[float]()
    for (road,), cell in values.group_by("road", maintain_order=True):
        for text, column, less, more in STATEMENTS:
            means = [
                cell.filter(pl.col("ego").str.contains(words)).group_by("seed").agg(pl.mean(column))
                for words in (less, more)
            ]
            differences = (means[0].sort("seed")[column] - means[1].sort("seed")[column]).to_numpy()
            p.append(stats.ttest_1samp(differences, 0.0, alternative="less").pvalue)
            mean = mean_of(differences)
            found = f"{mean.value:.3g} [{mean.low:.3g}, {mean.high:.3g}]"
            records.append({"road": road, "statement": text, "difference": found})
    for record, each in zip(records, holm(np.array(p)), strict=True):
        record["p (Holm)"] = f"{each:.2g}"
    return markdown(
        Table.plain(records, ("road", "statement"), dict.fromkeys([*records[0]][2:], ""))
    )


def straight(folder: Path) -> str:
    """What the networks do on the straight road: means of the seeds, beside the others."""
    run = charms_bench.open_run(folder)
    is_standard = pl.col("metric_set").str.starts_with("standard-")
    frame = run.table.frame().filter(is_standard, pl.col("metric").is_in([*ON_STRAIGHT]))
    label = pl.col("agent").str.split_exact(plan.SEED, 1).struct
    rows = frame.with_columns(label[0].alias("ego"), label[1].alias("seed"))
    records = []
    for (traffic, ego), cell in rows.group_by("traffic", "ego", maintain_order=True):
        record: dict[str, Any] = {"traffic": traffic, "ego": ego}
        for metric, (header, _) in ON_STRAIGHT.items():
            values = cell.filter(metric=metric)["value"].to_numpy()
            record[header] = mean_of(values, 0.0)
        records.append(record | {"seeds": str(cell["seed"].drop_nulls().n_unique() or "")})
    forms = dict(ON_STRAIGHT.values()) | {"seeds": ""}
    return markdown(Table.plain(records, ("traffic", "ego"), forms))


def limits(values: pl.DataFrame) -> str:
    """The limits of the plan, for each cell: the means of the seeds and whether they hold."""
    records = []
    for (road, traffic), cell in values.group_by("road", "traffic", maintain_order=True):
        human_s = cell.filter(ego="Human")["time_s"][0]
        goal, fault = LIMITS[str(road)]
        for column, bound, sign in (
            ("reached", goal, 1),
            ("at_fault", fault, -1),
            ("time_s", human_s, -1),
        ):
            header, form, worst = COLUMNS[column]
            each = cell.filter(ego=plan.CHARMS)[column].to_numpy()
            mean = mean_of(each, 0.0, 1.0 if form.endswith("%") else np.inf)
            ends = f" [{mean.low:{form}}, {mean.high:{form}}]" if mean.low is not None else ""
            record = {"road": road, "traffic": traffic, "quantity": header}
            record |= {"limit": f"{bound:{form}}"}
            record |= {"mean of the seeds": f"{mean.value:{form}}{ends}"}
            record |= {"worst seed": f"{worst(each):{form}}"}
            record |= {"mean holds": "yes" if sign * each.mean() >= sign * bound else "no"}
            records.append(record)
    keys = "road", "traffic", "quantity"
    return markdown(Table.plain(records, keys, dict.fromkeys([*records[0]][3:], "")))


def selected(values: pl.DataFrame) -> pl.DataFrame:
    """The seeds by the rule of selection, the first of which becomes CHARMS."""
    human = values.filter(ego="Human").select("road", "traffic", human_s="time_s")
    charms = values.filter(ego=plan.CHARMS).join(human, on=["road", "traffic"])
    goal, fault = (
        pl.col("road").replace_strict({road: each[k] for road, each in LIMITS.items()})
        for k in (0, 1)
    )
    met = [pl.col("reached") >= goal, pl.col("at_fault") <= fault]
    met.append(pl.col("time_s") <= pl.col("human_s"))
    return (
        charms.with_columns(limits_met=pl.sum_horizontal(*met))
        .group_by("seed")
        .agg(pl.sum("limits_met"), pl.mean("reached", "at_fault", "crashed", "time_s"))
        .sort("limits_met", "at_fault", "time_s", descending=[True, False, False])
    )


def tables(networks: Path, runs: Path) -> None:
    """Writes the tables of the plan and the CSV files beside them."""
    kept("plan-roads-trainings", trained(networks), "network")
    driven = [
        values
        for test in plan.TESTS
        if test not in (plan.STRAIGHT, plan.TRAFFIC) and len(values := values_of(runs, test))
    ]
    fine = pl.selectors.float().round_sig_figs(4)
    every = pl.concat(driven).with_columns(fine).with_columns(ROUGH)
    found = dict(kept("plan-roads-values", every, "test").partition_by("test", as_dict=True))
    found = {test: values for (test,), values in found.items()}
    of_validation = [found.pop(test) for test in plan.VALIDATION if test in found]
    if len(of_validation) == len(plan.VALIDATION):
        seeds = selected(pl.concat(of_validation)).cast({"seed": pl.String})
        forms = {"limits_met": ".0f"} | {name: COLUMNS[name][1] for name in seeds.columns[2:]}
        keep("plan-roads-selection", markdown(Table.plain(seeds.to_dicts(), ("seed",), forms)))
    if with_limits := [found[test] for test in ("people", "own") if test in found]:
        keep("plan-roads-limits", limits(pl.concat(with_limits)))
    if plan.OF_STYLES in found:
        keep("plan-roads-statements", statements(found[plan.OF_STYLES].drop_nulls("seed")))
    if (runs / plan.OF_STYLES).is_dir():
        by_seed = told(open_finished(runs / plan.OF_STYLES)).with_columns(pl.col("told").round(4))
        by_seed.write_csv(RESULTS / "plan-roads-told.csv")
        keep("plan-roads-told", told_table(by_seed))
    if (runs / plan.TRAFFIC).is_dir():
        keep("plan-roads-traffic", traffic_table(rates_of_traffic(runs / plan.TRAFFIC)))
    if (runs / plan.STRAIGHT).is_dir():
        keep("plan-roads-straight", straight(runs / plan.STRAIGHT))
    if found:
        # `levels` and `styles` drive the first episodes of `own` and `people` again.
        cells = pl.concat(found[test] for test in plan.TESTS if test in found)
        keys = ("road", "traffic")
        cells = cells.unique([*keys, "ego", "seed"], keep="first", maintain_order=True)
        is_style = pl.col("ego").is_in([each.replace("_", " ") for each in plan.STYLES])
        styles, others = cells.filter(is_style).sort("ego"), cells.remove(is_style)
        place = pl.col("ego").replace_strict({plan.CHARMS: 0, plan.LEVEL_1: 1}, default=2)
        keep("plan-roads", outcomes(others.sort(place, maintain_order=True), keys, "ego"))
        if len(styles):
            keep("plan-roads-styles", outcomes(styles, ("ego",), "road"))
