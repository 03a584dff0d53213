"""The tables of docs/training-plan.md, for `tools/write_results.py`.

Egos whose labels differ only in the seed are one training configuration: each value is the mean
over its seeds, with Student's t interval, and the value of the worst seed. `docs/results/plan.csv`
has the values of every seed.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy import special

from charms_bench import open_run
from charms_bench.metrics import PAPER, STANDARD, Metric
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import open_finished
from charms_bench.statistics.intervals import CONFIDENCE, Bounds
from charms_bench.world.scene import Floats, SceneSettings

ROOT = Path(__file__).parent.parent
Worst = Callable[[Floats], float]


def _furthest(low: float, high: float) -> Worst:
    """Of values that are to lie between two limits, the one that lies furthest outside."""
    return lambda values: float(max(values, key=lambda each: max(low - each, each - high)))


DRIVING: dict[str, tuple[str, str, Worst]] = {
    "crashed_at_fault": ("crashed at fault", ".2%", max),
    "crashed_episodes": ("crashed", ".2%", max),
    "speed_mean": ("speed, m/s", ".2f", min),
    "lane_changes_per_km": ("lane changes per km", ".2f", _furthest(0.1, 0.75)),
    "lane_changes_undone": ("undone", ".0%", max),
    "mean_acceleration_std": ("acceleration std, m/s²", ".2f", _furthest(0.2, 0.5)),
    "strong_acceleration_rate": ("above 1.1 m/s²", ".1%", max),
    "acceleration_reversals_per_min": ("reversals per minute", ".1f", _furthest(1.0, 6.0)),
    "centre_headway_below_1s": ("headway < 1 s", ".1%", _furthest(0.05, 0.21)),
    "yaw_std": ("yaw std", ".4f", max),
    "harsh_acc_rate": ("harsh", ".4f", max),
}
"""Header and format of each metric, and which of the seeds' values is the worst."""
SEALED: dict[str, tuple[str, str, Worst]] = {
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
STYLE_FORMS = {
    "speed_mean": ".2f",
    "time_headway_mean": ".2f",
    "imposed_braking_mean": ".3f",
    "gaps_taken_per_1000km": ".1f",
}
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
BEFORE = " before fine-tuning"
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
        of_seeds(folder, CONDITIONS[folder.name]) for folder in folders if folder.is_dir()
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
            record["CHARMS, worst seed"] = worst_of(found) if found.size else None
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
            (metric,) = _metrics(("crashed_at_fault",))
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


def of_seeds(run: Path, condition: str) -> pl.DataFrame:
    """The metrics of every seed of every configuration, one row per traffic and seed."""
    finished = open_finished(run)
    metrics = _metrics((*DRIVING, *SEALED))
    records: list[dict[str, Any]] = []
    for cell in finished.cells():
        ego, _, seed = cell.agent.partition(", seed ")
        labels = {"condition": condition, "traffic": cell.traffic, "ego": ego}
        found = _values(cell, metrics, finished.suite.scene)
        records.append({**labels, "seed": int(seed) if seed else None, **found})
    return pl.DataFrame(records, infer_schema_length=None).with_columns(
        pl.selectors.float().round_sig_figs(6)
    )


def _metrics(names: Sequence[str]) -> list[Metric]:
    """The metrics by name, those of the set `standard` first."""
    known = {each.name: each for found in (PAPER, STANDARD) for each in found.metrics}
    return [known[name] for name in dict.fromkeys(names)]


def _values(cell: CellRows, metrics: list[Metric], scene: SceneSettings) -> dict[str, float]:
    pairs = zip(metrics, cell.sums(metrics, scene), strict=True)
    return {metric.name: float(metric.value(each.sum(axis=0))) for metric, each in pairs}


def summary(
    values: pl.DataFrame, columns: dict[str, tuple[str, str, Worst]], keys: tuple[str, ...]
) -> str:
    """The table of configurations from the metrics of every seed, as Markdown."""
    records: list[dict[str, Any]] = []
    by = [key for key in keys if key != KEYS[-1]]
    for labels, part in values.group_by(by, maintain_order=True):
        over = f"mean of {part.height} [t interval]" if part.height > 1 else ""
        mean: dict[str, Any] = dict(zip(keys, (*labels, over), strict=True))
        worst: dict[str, Any] = dict(zip(keys, (*[""] * len(by), "worst seed"), strict=True))
        for metric, (header, form, worst_of) in columns.items():
            found = part[metric].to_numpy()
            mean[header] = Number(float(found.mean()), None, None, len(found))
            if len(found) > 1:
                low, high = t_interval(found)
                highest = 1.0 if form.endswith("%") else np.inf
                mean[header] = Number(found.mean(), max(low, 0.0), min(high, highest), len(found))
                worst[header] = worst_of(found)
        records += [mean, worst] if part.height > 1 else [mean]
    return markdown(Table.plain(records, keys, {h: form for h, form, _ in columns.values()}))


def t_interval(values: Floats) -> Bounds:
    """Student's t interval of the mean of independent values (..., n), at a nominal 95 %."""
    n = values.shape[-1]
    t = special.stdtrit(n - 1, (1 + CONFIDENCE) / 2)
    margin = t * values.std(axis=-1, ddof=1) / np.sqrt(n)
    mean = values.mean(axis=-1)
    return mean - margin, mean + margin


def plan_styles(run: Path) -> str:
    """What the plan says of the styles, before and after fine-tuning, and how far they differ."""
    finished = open_finished(run)
    scene, names = finished.suite.scene, tuple(name for name in STYLE_MEANS if name != "worst")
    networks = [each.agent.rpartition(", seed ") for each in finished.cells()]
    found = [_values(each, _metrics(names), scene) for each in finished.cells()]
    values = pl.DataFrame(
        [{"style": n[0], "seed": int(n[2]), **v} for n, v in zip(networks, found, strict=True)]
    )
    after = values.filter(~pl.col("style").str.ends_with(BEFORE))
    before = values.filter(pl.col("style").str.ends_with(BEFORE)).with_columns(
        pl.col("style").str.strip_suffix(BEFORE)
    )
    told = told_from_one_episode(
        [cell for cell in finished.cells() if BEFORE not in cell.agent], scene
    )
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
            first, second = (_of_group(values, metric, group) for group in groups)
            difference = first - second
            low, high = t_interval(difference)
            number = Number(float(difference.mean()), float(low), float(high))
            if when == "after":
                record |= {"first group": first.mean(), "other styles": second.mean()}
            record[f"difference {when} fine-tuning"] = number
        records.append(record)
    forms = {header: ".3f" for header in records[0] if header not in ("statement", "metric")}
    return markdown(Table.plain(records, ("statement", "metric"), forms))


def _of_group(values: pl.DataFrame, metric: str, group: str) -> Floats:
    """The mean over the styles of a group for every seed, in the order of the seeds."""
    words = "|".join(group.split())
    part = values.filter(pl.col("style").str.to_lowercase().str.contains(words))
    return part.group_by("seed").agg(pl.col(metric).mean()).sort("seed")[metric].to_numpy()


def style_variances(values: pl.DataFrame) -> str:
    """The standard deviation between styles and between the seeds of a style.

    Components of variance of a random model with one factor: the mean square between styles is in
    expectation the variance between seeds plus n times that between styles, for n seeds.
    """
    records: list[dict[str, Any]] = []
    for metric in STYLE_FORMS:
        table = np.stack([each[metric].to_numpy() for each in values.partition_by("style")])
        n = table.shape[1]
        seeds = table.var(axis=1, ddof=1).mean()
        styles = max(table.mean(axis=1).var(ddof=1) - seeds / n, 0.0)
        records.append({"metric": metric, "styles": np.sqrt(styles), "seeds": np.sqrt(seeds)})
    names = "std between styles", "std between seeds of a style"
    forms = {"styles": ".3f", "seeds": ".3f"}
    return markdown(Table.plain(records, ("metric",), forms).named(*names))


def told_from_one_episode(cells: Sequence[CellRows], scene: SceneSettings) -> Floats:
    """The share of episodes whose style is told right, for every seed, which is held out.

    Linear discriminant analysis of `OF_AN_EPISODE`; a metric that is not defined in an episode is
    put at the mean.
    """
    metrics = _metrics(OF_AN_EPISODE)
    by_seed: dict[str, list[Floats]] = {}
    for cell in cells:
        sums = cell.sums(metrics, scene)
        values = [metric.value(each) for metric, each in zip(metrics, sums, strict=True)]
        by_seed.setdefault(cell.agent.rpartition(", seed ")[2], []).append(np.stack(values, axis=1))
    known = np.stack([np.stack(styles) for styles in by_seed.values()])
    return np.array([_told(np.delete(known, k, axis=0), known[k]) for k in range(len(known))])


def _told(known: Floats, asked: Floats) -> float:
    """The share told right of `asked` [styles, E, K], by `known` [seeds, styles, E, K]."""
    flat = known.reshape(-1, known.shape[-1])
    mean, spread = np.nanmean(flat, axis=0), np.nanstd(flat, axis=0)

    def scaled(values: Floats) -> Floats:
        return np.asarray(np.nan_to_num((values - mean) / np.where(spread > 0, spread, 1.0)))

    of_styles = scaled(known).swapaxes(0, 1).reshape(known.shape[1], -1, known.shape[-1])
    centres = of_styles.mean(axis=1)
    within = (of_styles - centres[:, None]).reshape(-1, known.shape[-1])
    precision = np.linalg.pinv(within.T @ within / len(within))
    scores = (
        scaled(asked) @ precision @ centres.T
        - np.einsum("sk,kl,sl->s", centres, precision, centres) / 2
    )
    return float((scores.argmax(axis=-1) == np.arange(len(centres))[:, None]).mean())
