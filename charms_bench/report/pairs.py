"""How far the egos of a run are apart: pair by pair, and to somebody who guesses who drove.

All egos meet the same episodes, so differences are paired (`paired`); p-values are corrected over
all pairs and metrics (Holm 1979).
"""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.metrics import METRIC_SETS, Metric, sums_by_episode
from charms_bench.runs.cells import CellRows
from charms_bench.statistics import paired
from charms_bench.statistics.intervals import CONFIDENCE, resample, wilson
from charms_bench.world.files import write_atomically
from charms_bench.world.scene import Floats, SceneSettings

COMPARED = ("speed_mean", "dhw_mean", "harsh_acc_rate", "lane_changes_per_km")
"""Speed, headway, harshness and lane changes; by the first metric set that has the name."""
SUMMARY = (*COMPARED, "speed_std", "acc_std", "acc_mean", "dhw_std")
"""What an episode is known by to who guesses its driver."""
FOLDS = 10

SCHEMA: dict[str, pl.DataType] = {
    "first": pl.String(),
    "second": pl.String(),
    "metric": pl.String(),
    "difference": pl.Float64(),  # first less second; null where it is not defined
    "low": pl.Float64(),  # of the 95 % interval
    "high": pl.Float64(),
    "p": pl.Float64(),  # after Holm
    "separated": pl.Boolean(),
}

Difference = dict[str, str | float | bool | None]


def differences(cells: Sequence[CellRows], settings: SceneSettings, seed: int) -> list[Difference]:
    """For each pair of egos and each metric: first minus second.

    Returns:
        The rows (`SCHEMA`); None where the metric is not defined.
    """
    metrics = _metrics(COMPARED)
    sums = [sums_by_episode(metrics, cell.episodes, cell.steps, settings) for cell in cells]
    weights = resample(np.random.default_rng(seed), len(cells[0].episodes))
    rows: list[Difference] = []
    raw = []
    for i, j in combinations(range(len(cells)), 2):
        found = paired.differences(metrics, sums[i], sums[j], weights)
        for metric, difference in zip(metrics, found, strict=True):
            raw.append(difference.p)
            rows.append(
                {
                    "first": cells[i].agent,
                    "second": cells[j].agent,
                    "metric": metric.name,
                    "difference": _defined(difference.value),
                    "low": _defined(difference.low),
                    "high": _defined(difference.high),
                }
            )
    for row, p in zip(rows, paired.holm(np.array(raw)), strict=True):
        row |= {"p": float(p), "separated": bool(p < 1 - CONFIDENCE)}
    return rows


def guessed(cells: Sequence[CellRows], settings: SceneSettings, seed: int) -> tuple[int, int]:
    """In how many episodes, of how many, the ego is guessed right from the episode's summary.

    The guess is the ego with the nearest mean summary, each number in units of its standard
    deviation. Means are of other episodes than the guessed one: ten folds by the episodes' seeds.
    """
    metrics = _metrics(SUMMARY)
    features = np.stack(
        [
            np.stack(
                [
                    metric.value(each)
                    for metric, each in zip(
                        metrics,
                        sums_by_episode(metrics, cell.episodes, cell.steps, settings),
                        strict=True,
                    )
                ],
                axis=1,
            )
            for cell in cells
        ]
    )
    egos, episodes, _ = features.shape
    fold = np.random.default_rng(seed).permutation(episodes) % min(FOLDS, episodes)
    right = 0
    for k in np.unique(fold):
        right += _right(features[:, fold != k], features[:, fold == k])
    return right, egos * episodes


def _right(known: Floats, asked: Floats) -> int:
    flat = known.reshape(-1, known.shape[-1])
    defined = ~np.isnan(flat)
    count = np.maximum(defined.sum(axis=0), 1)
    mean = np.where(defined, flat, 0.0).sum(axis=0) / count
    spread = np.sqrt((np.where(defined, flat - mean, 0.0) ** 2).sum(axis=0) / count)
    spread[spread == 0] = 1.0

    def scaled(values: Floats) -> Floats:
        """What is not defined in an episode says nothing: it is put at the mean."""
        result: Floats = np.nan_to_num((values - mean) / spread)
        return result

    centres = scaled(known).mean(axis=1)
    distance = ((scaled(asked)[:, :, None] - centres) ** 2).sum(axis=-1)
    guess: NDArray[np.intp] = distance.argmin(axis=-1)
    return int((guess == np.arange(len(known))[:, None]).sum())


def write_pairs(
    folder: Path, name: str, cells: Sequence[CellRows], settings: SceneSettings, seed: int
) -> None:
    """Writes `<name>-pairs.csv` and, for reading, `<name>-pairs.md` into a folder."""
    rows = differences(cells, settings, seed)
    write_atomically(folder / f"{name}-pairs.csv", pl.DataFrame(rows, schema=SCHEMA).write_csv)
    text = _markdown(rows, *guessed(cells, settings, seed), len(cells))
    write_atomically(folder / f"{name}-pairs.md", lambda path: path.write_bytes(text.encode()))


def _markdown(rows: Sequence[Difference], right: int, asked: int, egos: int) -> str:
    pairs: dict[tuple[object, ...], list[Difference]] = {}
    for row in rows:
        pairs.setdefault((row["first"], row["second"]), []).append(row)
    apart = sum(any(row["separated"] for row in found) for found in pairs.values())
    low, high = wilson(right, asked)
    guess = (
        f"From the summary of one episode its ego is guessed right in {right / asked:.1%} of "
        f"{asked:,} cases [{low:.1%}, {high:.1%}]; by chance it would be {1 / egos:.1%}."
    )
    lines = [
        f"{apart} of {len(pairs)} pairs are apart in some metric (Holm-corrected p < 0.05, bold).",
        "",
        guess,
        "",
        "Differences, first minus second, with 95 % intervals.",
        "",
        "| first | second | " + " | ".join(COMPARED) + " |",
        "|---|---|" + "---:|" * len(COMPARED),
    ]
    for (first, second), found in pairs.items():
        cells = " | ".join(map(_cell, found))
        lines.append(f"| {first} | {second} | {cells} |")
    return "\n".join(lines) + "\n"


def _cell(row: Difference) -> str:
    if row["difference"] is None:
        return "–"
    text = f"{row['difference']:+.3g}"
    if row["low"] is not None:
        text += f" [{row['low']:.3g}, {row['high']:.3g}]"
    return f"**{text}**" if row["separated"] else text


def _metrics(names: Sequence[str]) -> list[Metric]:
    known = [metric for metric_set in METRIC_SETS for metric in metric_set.metrics]
    return [next(metric for metric in known if metric.name == name) for name in names]


def _defined(value: float) -> float | None:
    return None if np.isnan(value) else value
