"""The tables of docs/training-plan.md, for `tools/write_results.py`.

Egos whose labels differ only in the seed are one training configuration: each value is the mean
over its seeds, with Student's t interval, and the value of the worst seed. `docs/results/plan.csv`
has the values of every seed.
"""

import json
from pathlib import Path
from typing import Any

import polars as pl
from plan_seeds import Columns, furthest, metrics_of, of_seeds, summary, t_interval
from plan_styles import BEFORE, of_episodes, of_group, style_variances, told_right

from charms_bench import open_run
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished

ROOT = Path(__file__).parent.parent
DRIVING: Columns = {
    "crashed_at_fault": ("crashed at fault", ".2%", max),
    "crashed_episodes": ("crashed", ".2%", max),
    "speed_mean": ("speed, m/s", ".2f", min),
    "lane_changes_per_km": ("lane changes per km", ".2f", furthest(0.1, 0.75)),
    "lane_changes_undone": ("undone", ".0%", max),
    "mean_acceleration_std": ("acceleration std, m/s²", ".2f", furthest(0.2, 0.5)),
    "strong_acceleration_rate": ("above 1.1 m/s²", ".1%", max),
    "acceleration_reversals_per_min": ("reversals per minute", ".1f", furthest(1.0, 6.0)),
    "centre_headway_below_1s": ("headway < 1 s", ".1%", furthest(0.05, 0.21)),
    "yaw_std": ("yaw std", ".4f", max),
    "harsh_acc_rate": ("harsh", ".4f", max),
}
"""Header and format of each metric, and which of the seeds' values is the worst."""
SEALED: Columns = {
    "crashed_at_fault": ("crashed at fault", ".1%", max),
    "lag_gap_mean": ("lag gap, m", ".1f", min),
    "imposed_braking_mean": ("imposed braking, m/s²", ".2f", max),
    "closing_speed_below_1s_mean": (
        "closing speed when the headway falls below 1 s, m/s",
        ".2f",
        max,
    ),
}
"""What is compared in the other conditions."""
CONDITIONS = {
    "seeds-main": "3 lanes, density 1",
    "seeds-density-1-5": "density 1.5",
    "seeds-density-2-0": "density 2",
    "seeds-lanes-2": "2 lanes",
    "seeds-lanes-5": "5 lanes",
    "seeds-density-1-25": "density 1.25 (sealed)",
    "seeds-lanes-4": "4 lanes (sealed)",
    "seeds-trucks": "trucks (sealed)",
}
"""The runs of the test, by their folders."""
AVOIDED = ("IDM+MOBIL", "IDM+MOBIL, varied")
"""The traffics in which crashes are searched for actions that avoid them."""
MAIN = ("Human (I-75)", "IDM+MOBIL")
"""The traffics of the main test."""
SHOWN = ("IDM+MOBIL", "Human (I-75)", "DQN", "PPO", "CHARMS")
"""The egos in the tables of other conditions; `docs/results/plan.csv` has the others, too."""
KEYS = ("traffic", "ego", "over the seeds")
STYLES = {
    "efficient styles are faster": ("speed_mean", "efficient", "safe"),
    "safe styles keep longer headways": ("time_headway_mean", "safe", "efficient"),
    "prosocial and altruistic styles impose less braking": (
        "imposed_braking_mean",
        "prosocial altruistic",
        "competitive egoistic",
    ),
    "prosocial and altruistic styles take fewer gaps": (
        "gaps_taken_per_1000km",
        "prosocial altruistic",
        "competitive egoistic",
    ),
}
"""What the plan says of the styles: the metric, and the two groups that it compares."""
FAULT = "crashed_at_fault"
STYLE_MEANS = {
    "speed_mean": ("speed, m/s", ".2f"),
    "time_headway_mean": ("mean headway, s", ".2f"),
    "lane_changes_per_km": ("lane changes per km", ".2f"),
    "imposed_braking_mean": ("imposed braking, m/s²", ".2f"),
    "gaps_taken_per_1000km": ("gaps taken per 1,000 km", ".1f"),
    FAULT: ("crashed at fault", ".2%"),
    "worst": ("worst seed", ".2%"),
}
"""Header and format of what the table of styles shows."""
OF_AN_EPISODE = (
    "speed_mean",
    "time_headway_mean",
    "mean_acceleration_std",
    "strong_acceleration_rate",
    "acceleration_reversals_per_min",
    "lane_changes_per_km",
    "lag_gap_mean",
    "centre_headway_below_1s",
)
"""What describes an episode when the style of its ego is told."""


def plan_main(run: Path) -> str:
    """The table of the main test; writes the values of every condition and seed, too."""
    folders = [run.parent / folder for folder in CONDITIONS]
    values = pl.concat(
        of_seeds(open_finished(folder), (*DRIVING, *SEALED)).select(
            pl.lit(CONDITIONS[folder.name]).alias("condition"), pl.all()
        )
        for folder in folders
        if folder.is_dir()
    )
    values.write_csv(ROOT / "docs" / "results" / "plan.csv")
    return summary(values.filter(_of_main()), DRIVING, KEYS)


def plan_conditions(run: Path) -> str:
    """A table per metric of `SEALED`, from the values that `plan_main` has written."""
    values = pl.read_csv(ROOT / "docs" / "results" / "plan.csv").filter(~_of_main())
    places = ["condition", "traffic"]
    tables = []
    for metric, (header, form, worst_of) in SEALED.items():
        records = []
        for labels, part in values.group_by(places, maintain_order=True):
            record: dict[str, Any] = dict(zip(places, labels, strict=True))
            for ego in SHOWN:
                found = part.filter(pl.col("ego") == ego)[metric].drop_nans().to_numpy()
                record[ego] = float(found.mean()) if found.size else None
            record["CHARMS, worst seed"] = worst_of(found) if worst_of and found.size else None
            records.append(record)
        forms = dict.fromkeys([*SHOWN, "CHARMS, worst seed"], form)
        table = markdown(Table.plain(records, ("condition", "traffic"), forms))
        tables.append(f"**{header[0].upper()}{header[1:]}**\n\n{table}")
    return "\n".join(tables)


def plan_avoidability(run: Path) -> str:
    """Of the crashes of CHARMS, those that no sequence of its meta-actions avoids, by search."""
    records: list[dict[str, Any]] = []
    for folder, condition in CONDITIONS.items():
        if not (run.parent / folder).is_dir():
            continue
        opened = open_run(run.parent / folder, ROOT / "suites" / "seeds")
        finished = open_finished(run.parent / folder)
        for cell in finished.cells():
            if not cell.agent.startswith("CHARMS, seed") or cell.traffic not in AVOIDED:
                continue
            (metric,) = metrics_of(("crashed_at_fault",))
            at_fault = metric.value(cell.sums([metric], finished.suite.scene)[0]) > 0
            found = opened.avoidability(ego=cell.agent, traffic=cell.traffic)
            verdicts = [
                (each.verdict, bool(at_fault[each.episode - finished.suite.seed])) for each in found
            ]
            counts = {
                "crashed": len(verdicts),
                "no actions avoid it": sum(verdict == "spawn" for verdict, _ in verdicts),
                "not known": sum(verdict == "unknown" for verdict, _ in verdicts),
                "at fault": sum(fault for _, fault in verdicts),
                "at fault, avoidable": sum(f and verdict != "spawn" for verdict, f in verdicts),
            }
            shares = {name: count / len(at_fault) for name, count in counts.items()}
            records.append({"condition": condition, "traffic": cell.traffic, **shares})
    means = pl.DataFrame(records).group_by("condition", "traffic", maintain_order=True).mean()
    worst = (
        pl.DataFrame(records)
        .group_by("condition", "traffic", maintain_order=True)
        .agg(pl.col("at fault, avoidable").max().alias("worst seed"))
    )
    table = means.join(worst, on=["condition", "traffic"], maintain_order="left")
    forms = dict.fromkeys(table.columns[2:], ".1%")
    return markdown(Table.plain(table.to_dicts(), ("condition", "traffic"), forms))


def plan_likeness(run: Path) -> str:
    """The likeness to the drivers of the test, from what the command `likeness` printed."""
    scores = json.loads((run / "likeness.json").read_text(encoding="utf-8"))
    headers = {"closed_loop": "closed loop", "given_scene": "given scene", "events": "events"}
    headers["total"] = "total"
    records = [
        {
            "driver": each["label"],
            "kind": each["kind"],
            **{
                header: Number(found["value"], found["low"], found["high"])
                for name, header in headers.items()
                if (found := each["scores"].get(name))
            },
        }
        for each in scores
    ]
    forms = dict.fromkeys(headers.values(), ".2f")
    return markdown(Table.plain(records, ("driver", "kind"), forms))


def _of_main() -> pl.Expr:
    is_there = pl.col("condition") == CONDITIONS["seeds-main"]
    return is_there & pl.col("traffic").is_in(MAIN)


def plan_styles(run: Path) -> str:
    """What the plan says of the styles, before and after fine-tuning, and how far they differ."""
    finished = open_finished(run)
    names = tuple(name for name in STYLE_MEANS if name != "worst")
    values = of_seeds(finished, names).rename({"ego": "style"}).drop("traffic")
    after = values.filter(~pl.col("style").str.ends_with(BEFORE))
    before = values.filter(pl.col("style").str.ends_with(BEFORE)).with_columns(
        pl.col("style").str.strip_suffix(BEFORE)
    )
    cells = [cell for cell in finished.cells() if BEFORE not in cell.agent]
    told = told_right(of_episodes(cells, finished.suite.scene, OF_AN_EPISODE))
    low, high = t_interval(told)
    accuracy = f"{told.mean():.1%} [{100 * low:.1f}, {100 * high:.1f}]".replace("%", " %")
    styles = after["style"].n_unique()
    chance = f"{1 / styles:.1%}".replace("%", " %")
    return (
        f"{style_means(after)}\n{style_statements(before, after)}\n{style_variances(after)}\n"
        f"From one episode, the style is told right in {accuracy} of the cases (mean over "
        f"{told.size} training seeds, each held out from the classifier); by chance it would be "
        f"{chance}.\n"
    )


def style_means(values: pl.DataFrame) -> str:
    """The mean of every style over its seeds, and of `FAULT` the worst seed, too."""
    worst = values.group_by("style").agg(pl.col(FAULT).max().alias("worst"))
    means = values.group_by("style", maintain_order=True).agg(pl.exclude("seed").mean())
    shown = means.join(worst, on="style", maintain_order="left").select("style", *STYLE_MEANS)
    forms = {name: form for name, (_, form) in STYLE_MEANS.items()}
    headers = [header for header, _ in STYLE_MEANS.values()]
    return markdown(Table.plain(shown.to_dicts(), ("style",), forms).named(*headers))


def style_statements(before: pl.DataFrame, after: pl.DataFrame) -> str:
    """Each statement of the plan by a difference of styles, paired by seed."""
    records: list[dict[str, Any]] = []
    for statement, (metric, *groups) in STYLES.items():
        record: dict[str, Any] = {"statement": statement, "metric": metric}
        for when, values in (("before", before), ("after", after)):
            first, second = (of_group(values, metric, group) for group in groups)
            difference = first - second
            low, high = t_interval(difference)
            number = Number(float(difference.mean()), float(low), float(high))
            if when == "after":
                record |= {"first group": first.mean(), "other styles": second.mean()}
            record[f"difference {when} fine-tuning"] = number
        records.append(record)
    forms = {header: ".3f" for header in records[0] if header not in ("statement", "metric")}
    return markdown(Table.plain(records, ("statement", "metric"), forms))
