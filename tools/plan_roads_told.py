"""How well a style is told from one episode, for the tables of `plan_roads_tables`.

Linear discriminant analysis, which has seen the styles of the other seeds.
"""

from collections.abc import Sequence

import numpy as np
import plan_roads as plan
import polars as pl

from charms_bench.metrics.sets import metrics_of
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
    records = []
    for road in dict.fromkeys(cell.road for cell in run.suite.cells):
        cells = [run.cell(k) for k in run.finished if run.suite.cells[k].road == road]
        cells = [cell for cell in cells if plan.SEED in cell.agent]
        seeds = list(dict.fromkeys(cell.agent.partition(plan.SEED)[2] for cell in cells))
        scene = run.suite.cells[0].scene
        for by, names in TOLD_BY.items():
            known = np.stack(
                [
                    _of_episodes(
                        [each for each in cells if each.agent.endswith(seed)], scene, names
                    )
                    for seed in seeds
                ]
            )
            for k, seed in enumerate(seeds):
                right = told_right(np.delete(known, k, axis=0), known[k])
                records.append({"road": str(road), "by": by, "seed": int(seed), "told": right})
    return pl.DataFrame(records)


def _of_episodes(cells: Sequence[CellRows], scene: SceneSettings, names: Sequence[str]) -> Floats:
    """[styles, E, K] metrics of the episodes of a seed; NaN where they are not defined."""
    metrics = metrics_of(names)
    values = []
    for cell in sorted(cells, key=lambda each: each.agent):
        sums = cell.sums(metrics, scene)
        each = [metric.value(part) for metric, part in zip(metrics, sums, strict=True)]
        values.append(np.stack(each, axis=1))
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
