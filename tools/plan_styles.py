"""What the plan says of the styles: how they differ, how well they are told, and PCH of them."""

from collections import Counter
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
import polars as pl
from plan_seeds import OVER, SEED, Columns, mean_of, metrics_of, of_seeds, summary, t_interval
from scipy import stats

from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import FinishedRun
from charms_bench.statistics.paired import holm
from charms_bench.world.scene import Floats, SceneSettings

BEFORE = " before fine-tuning"
STATEMENTS = {
    "efficient styles are faster": ("speed_mean", "efficient", "safe"),
    "safe styles keep longer headways": ("time_headway_mean", "safe", "efficient"),
    "prosocial and altruistic styles impose less braking": (
        "imposed_braking_mean",
        "competitive egoistic",
        "prosocial altruistic",
    ),
    "prosocial and altruistic styles take fewer gaps": (
        "gaps_taken_per_1000km",
        "competitive egoistic",
        "prosocial altruistic",
    ),
}
"""What the plan says: the metric, the styles with more of it, and those with less."""
STYLES: Columns = {
    "speed_mean": ("speed, m/s", ".2f", None),
    "time_headway_mean": ("mean headway, s", ".2f", None),
    "lane_changes_per_km": ("lane changes per km", ".2f", None),
    "imposed_braking_mean": ("imposed braking, m/s²", ".2f", None),
    "gaps_taken_per_1000km": ("gaps taken per 1,000 km", ".1f", None),
    "crashed_at_fault": ("crashed at fault", ".2%", max),
}
RELATIVE_SPEED = "relative_speed"
"""The ego's mean speed less that of the traffic, which no metric has."""
_CONDUCT = (
    "time_headway_mean",
    "lead_gap_mean",
    "lag_gap_mean",
    "gaps_taken_per_1000km",
    "gaps_lost_per_1000km",
    "imposed_braking_mean",
)
TOLD_BY: dict[str, tuple[str, ...]] = {
    "headway, relative speed, gaps, yielding and imposed braking": (*_CONDUCT, RELATIVE_SPEED),
    "the same without relative speed": _CONDUCT,
    "mean speed alone": ("speed_mean",),
}
"""By what the style of an episode's ego is told."""
STYLE_TRAFFIC: Columns = {
    "traffic_crashes_per_1000km": ("crashed vehicles per 1,000 km", ".1f", max),
    "traffic_speed_mean": ("speed of the traffic, m/s", ".2f", None),
    "traffic_gaps_taken_per_1000km": ("gaps taken per 1,000 km", ".1f", None),
}
PCH: Columns = {
    "traffic_speed_mean": ("speed, m/s", ".2f", None),
    "traffic_hard_braking_by_per_1000km": ("hard braking imposed per 1,000 km", ".1f", None),
    "traffic_gaps_taken_per_1000km": ("gaps taken per 1,000 km", ".1f", None),
    "traffic_rss_by": ("too close (RSS)", ".1%", None),
    "traffic_crashes_per_1000km": ("crashed vehicles per 1,000 km", ".1f", max),
    "speed_mean": ("ego: speed, m/s", ".2f", None),
    "time_headway_mean": ("ego: mean headway, s", ".2f", None),
    "conflicts_to_per_1000km": ("ego: conflicts caused by others per 1,000 km", ".1f", None),
    "hard_braking_to_per_1000km": ("ego: hard braking caused by others per 1,000 km", ".1f", None),
    "gaps_lost_per_1000km": ("ego: gaps lost per 1,000 km", ".1f", None),
}
"""Of the traffic, and then of the ego in it."""


def styles_frame(run: FinishedRun) -> pl.DataFrame:
    """The metrics of every style before and after fine-tuning, of the seeds that have all."""
    is_before = pl.col("ego").str.ends_with(BEFORE)
    values = of_seeds(run, tuple(STYLES)).select(
        pl.col("ego").str.strip_suffix(BEFORE).alias("style"),
        pl.when(is_before).then(pl.lit("before")).otherwise(pl.lit("after")).alias("fine-tuning"),
        pl.exclude("traffic", "ego"),
    )
    return values.filter(pl.len().over("seed", "fine-tuning") == values["style"].n_unique())


def plan_styles(values: pl.DataFrame, told: pl.DataFrame) -> str:
    """The means of the styles, the statements, the variances, and how well styles are told."""
    after = values.filter(pl.col("fine-tuning") == "after")
    named = after.with_columns(pl.col("style").str.replace("_", " "))
    chance = f"{1 / after['style'].n_unique():.1%}".replace("%", " %")
    parts = [
        summary(named, STYLES, ("style", OVER)),
        f"{style_statements(values)}\np: paired t test, corrected over the table by Holm.\n",
        style_variances(after),
        f"{told_table(told)}\nBy chance, {chance} of the episodes would be told right.\n",
    ]
    return "\n".join(parts)


def statements(values: pl.DataFrame) -> pl.DataFrame:
    """Each statement by a difference of styles, paired by seed, with corrected p-values.

    A difference is positive if the statement holds. The p-values are those of two-sided paired t
    tests, corrected over all statements, before and after fine-tuning.
    """
    records: list[dict[str, Any]] = []
    for when in ("before", "after"):
        part = values.filter(pl.col("fine-tuning") == when)
        for statement, (metric, *groups) in STATEMENTS.items():
            more, less = (of_group(part, metric, group) for group in groups)
            if more.size < 2:
                continue
            records.append(
                {
                    "statement": statement,
                    "metric": metric,
                    "fine-tuning": when,
                    "more": more.mean(),
                    "less": less.mean(),
                    "difference": (more - less).mean(),
                    **dict(zip(("low", "high"), t_interval(more - less), strict=True)),
                    "p": stats.ttest_rel(more, less).pvalue,
                }
            )
    found = pl.DataFrame(records)
    return found.with_columns(pl.Series("p", holm(found["p"].to_numpy())))


def style_statements(values: pl.DataFrame) -> str:
    """The table of the statements."""
    records = [
        {**each, "difference": Number(each["difference"], each["low"], each["high"])}
        for each in statements(values).to_dicts()
    ]
    forms = dict.fromkeys(("more", "less", "difference"), ".3f") | {"p": "p"}
    return markdown(Table.plain(records, ("statement", "metric", "fine-tuning"), forms))


def of_group(values: pl.DataFrame, metric: str, group: str) -> Floats:
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
    for metric, *_ in STATEMENTS.values():
        table = np.stack([each[metric].to_numpy() for each in values.partition_by("style")])
        n = table.shape[1]
        seeds = table.var(axis=1, ddof=1).mean()
        styles = max(table.mean(axis=1).var(ddof=1) - seeds / n, 0.0)
        records.append({"metric": metric, "styles": np.sqrt(styles), "seeds": np.sqrt(seeds)})
    names = "std between styles", "std between seeds of a style"
    forms = {"styles": ".3f", "seeds": ".3f"}
    return markdown(Table.plain(records, ("metric",), forms).named(*names))


def told_frame(run: FinishedRun) -> pl.DataFrame:
    """The proportion of episodes whose style is told right, by `TOLD_BY` and held-out seed."""
    cells = [each for each in run.cells() if BEFORE not in each.agent]
    counts = Counter(each.agent.rpartition(SEED)[2] for each in cells)
    seeds = [seed for seed, count in counts.items() if count == max(counts.values())]
    cells = [each for each in cells if each.agent.rpartition(SEED)[2] in seeds]
    names = [name for name in dict.fromkeys(chain(*TOLD_BY.values())) if name != RELATIVE_SPEED]
    known = of_episodes(cells, run.suite.scene, [*names, "traffic_speed_mean"])
    names.append(RELATIVE_SPEED)  # in the place of the traffic's
    known[..., -1] = known[..., names.index("speed_mean")] - known[..., -1]
    records = [
        {"by": by, "seed": int(seed), "told": told}
        for by, chosen in TOLD_BY.items()
        for seed, told in zip(
            seeds, told_right(known[..., [names.index(each) for each in chosen]]), strict=True
        )
    ]
    return pl.DataFrame(records)


def told_table(told: pl.DataFrame) -> str:
    """How well styles are told from one episode, a row for each of `TOLD_BY`."""
    columns: Columns = {"told": ("told right", ".1%", min)}
    return summary(told.rename({"by": "style told by"}), columns, ("style told by", OVER))


def of_episodes(cells: Sequence[CellRows], scene: SceneSettings, names: Sequence[str]) -> Floats:
    """[seeds, styles, E, K] metrics of every episode; NaN where they are not defined."""
    metrics = metrics_of(names)
    by_seed: dict[str, list[Floats]] = {}
    for cell in cells:
        sums = cell.sums(metrics, scene)
        values = [metric.value(each) for metric, each in zip(metrics, sums, strict=True)]
        by_seed.setdefault(cell.agent.rpartition(SEED)[2], []).append(np.stack(values, axis=1))
    return np.stack([np.stack(styles) for styles in by_seed.values()])


def told_right(known: Floats) -> Floats:
    """The proportion of episodes whose style is told right, for every seed, which is held out."""
    return np.array([told_of(np.delete(known, k, axis=0), known[k]) for k in range(len(known))])


def told_of(known: Floats, asked: Floats) -> float:
    """The proportion told right of `asked` [styles, E, K], by `known` [seeds, styles, E, K].

    Linear discriminant analysis; a value that is not defined is put at the mean.
    """
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


def pch_differences(values: pl.DataFrame, of: str) -> pl.DataFrame:
    """The metrics at the largest `of`, tau or beta, less those at the smallest, by seed.

    `at` is the other parameter; null for the means over it.
    """
    other = "beta" if of == "tau" else "tau"
    values = values.with_columns(
        pl.col("traffic").str.extract(rf"{name} ([\d.]+)").cast(float).alias(name)
        for name in ("tau", "beta")
    ).sort(other, "seed")
    ends = [
        values.filter(pl.col(of) == end).select(*PCH)
        for end in (values[of].max(), values[of].min())
    ]
    keys = values.filter(pl.col(of) == values[of].max()).select("seed", at=other)
    found = pl.concat([keys, ends[0] - ends[1]], how="horizontal")
    over = found.group_by("seed", maintain_order=True).mean().with_columns(at=None)
    return pl.concat([found, over.select(found.columns)], how="vertical_relaxed")


def plan_pch(values: pl.DataFrame) -> str:
    """The traffic by tau and beta, and its differences paired by seed."""
    records: list[dict[str, Any]] = []
    for of, other, words in (
        ("beta", "tau", "beta 1 less beta 0"),
        ("tau", "beta", "tau 3 less tau 0.5"),
    ):
        for (at,), part in pch_differences(values, of).group_by("at", maintain_order=True):
            record: dict[str, Any] = {"difference": words}
            record["at"] = f"mean over {other}" if at is None else f"{other} {at:g}"
            record |= {
                header: mean_of(part[metric].to_numpy()) for metric, (header, *_) in PCH.items()
            }
            records.append(record)
    forms = {header: form for header, form, _ in PCH.values()}
    differences = markdown(Table.plain(records, ("difference", "at"), forms))
    return f"{summary(values, PCH, ('traffic', OVER))}\n{differences}"
