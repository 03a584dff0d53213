"""How well a style is told from one episode, for the tables of `plan_roads_tables`.

Linear discriminant analysis, which has seen the styles of the other seeds.
"""

from collections.abc import Sequence

import numpy as np
import plan_roads as plan
import polars as pl
from plan_roads_values import mean_of

from charms_bench.metrics.metric import Metric
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import FinishedRun
from charms_bench.world.scene import Floats, SceneSettings

TOLD_BY: dict[str, tuple[str, ...]] = {
    "gaps, yielding and imposed braking": (
        "time_headway_mean", "lead_gap_mean", "lag_gap_mean", "gaps_taken_per_1000km",
        "gaps_lost_per_1000km", "imposed_braking_mean", "entry_lead_gap", "entry_lag_gap",
        "entry_imposed_braking", "entry_pet",
    ),
    "mean speed alone": ("speed_mean",),
}  # fmt: skip
"""The metrics of an episode by which its style is told."""


def told(run: FinishedRun) -> pl.DataFrame:
    """The proportion of episodes whose style is told right, by road and seed, which is held out."""
    defined = {each.name: each for part in run.suite.metric_sets for each in part.metrics}
    by_road: dict[str, dict[str, list[CellRows]]] = {}
    for cell in map(run.cell, run.finished):
        style, _, seed = cell.agent.partition(plan.SEED)
        if seed and style.replace(" ", "_") in plan.STYLES:
            by_road.setdefault(str(cell.road), {}).setdefault(seed, []).append(cell)
    records = []
    for road, cells in by_road.items():
        for by, names in TOLD_BY.items():
            metrics = [defined[name] for name in names]
            scene = run.suite.scene
            known = np.stack([_of_episodes(each, scene, metrics) for each in cells.values()])
            for k, seed in enumerate(cells):
                right = told_right(np.delete(known, k, axis=0), known[k])
                records.append({"road": road, "by": by, "seed": int(seed), "told": right})
    return pl.DataFrame(records)


def _of_episodes(
    styles: Sequence[CellRows], scene: SceneSettings, metrics: Sequence[Metric]
) -> Floats:
    """[styles, E, K] metrics of the episodes of a seed; NaN where they are not defined."""
    values = []
    for cell in sorted(styles, key=lambda each: each.agent):
        sums = zip(metrics, cell.sums(metrics, scene), strict=True)
        values.append(np.stack([metric.value(each) for metric, each in sums], axis=1))
    return np.stack(values)


def told_right(known: Floats, asked: Floats) -> float:
    """The proportion told right of `asked` [styles, E, K], by `known` [seeds, styles, E, K].

    A value that is not defined is put at the mean.
    """
    flat = known.reshape(-1, known.shape[-1])
    mean, spread = np.nanmean(flat, axis=0), np.nanstd(flat, axis=0)

    def scaled(values: Floats) -> Floats:
        return np.asarray(np.nan_to_num((values - mean) / np.where(spread > 0, spread, 1.0)))

    of_styles = scaled(known).swapaxes(0, 1).reshape(known.shape[1], -1, known.shape[-1])
    centres = of_styles.mean(axis=1)
    within = (of_styles - centres[:, None]).reshape(-1, known.shape[-1])
    precision = np.linalg.pinv(within.T @ within / len(within))
    offsets = np.einsum("sk,kl,sl->s", centres, precision, centres) / 2
    scores = scaled(asked) @ precision @ centres.T - offsets
    return float((scores.argmax(axis=-1) == np.arange(len(centres))[:, None]).mean())


def told_table(values: pl.DataFrame) -> str:
    """How well a style is told from one episode: the mean of the seeds, each held out."""
    records = [
        {"road": road, "told by": by, "told right": mean_of(cell["told"].to_numpy(), 0.0, 1.0)}
        for (road, by), cell in values.group_by("road", "by", maintain_order=True)
    ]
    return markdown(Table.plain(records, ("road", "told by"), {"told right": ".1%"}))
