"""Comparisons of simulated runs hold what they promise: 200 pairs of runs of each kind.

Two runs of one agent and the same seeds are the same run, and differ in nothing. So the agents
here have whims, drawn from what they see and a seed of their own: `one` and `other` are drivers
of one kind who act differently in the same episodes, and every difference found between them is a
false alarm. `noisier` has twice as many whims. `faster` is `other` with 0.3 m/s on top of every
speed that was recorded, a difference known exactly; that of `noisier` is taken from all episodes,
200 times as many as a comparison sees.
"""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from charms_bench.metrics import METRIC_SETS
from charms_bench.report.comparison import compare, to_dicts
from charms_bench.runs.cells import CellRows
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite

REPETITIONS = 200
EPISODES = 150
FASTER_MPS = 0.3
METRICS = sum(len(metric_set.metrics) for metric_set in METRIC_SETS)
SUITE = {
    "suite": "whims",
    "episodes": REPETITIONS * EPISODES,
    "egos": [
        {"agent": {"name": "outside_explorer", "options": {"noise": noise, "seed": seed}}, **label}
        for noise, seed, label in (
            (0.1, 1, {"label": "one"}),
            (0.1, 2, {"label": "other"}),
            (0.2, 3, {"label": "noisier"}),
        )
    ],
    "traffic_models": [{"traffic": "idm_mobil"}],
}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> dict[str, CellRows]:
    suite = Suite.model_validate(SUITE)
    found = {
        cell.agent: cell for cell in run(suite, tmp_path_factory.mktemp("run"), workers=1).cells()
    }
    other = found["other"]
    faster = other.steps.with_columns(pl.col("speed") + FASTER_MPS)
    drivers = [(pl.concat(rows for (rows,) in other.drivers),)]
    parts = [(other.episodes, faster)]
    return {**found, "faster": replace(other, agent="faster", parts=parts, drivers=drivers)}


def part(cell: CellRows, repetition: int) -> CellRows:
    """The episodes of one repetition, which no other has."""
    own = pl.col("episode") // EPISODES == repetition
    episodes, steps = cell.episodes.filter(own), cell.steps.filter(own)
    drivers = pl.concat(rows.filter(own) for (rows,) in cell.drivers)
    return replace(cell, size=len(episodes), parts=[(episodes, steps)], drivers=[(drivers,)])


def compared(cells: dict[str, CellRows], second: str) -> list[list[dict[str, Any]]]:
    """[REPETITIONS][METRICS]"""
    scene = Suite.model_validate(SUITE).scene
    return [
        to_dicts(
            compare([(part(cells["one"], k), part(cells[second], k))], METRIC_SETS, scene, seed=k)
        )
        for k in range(REPETITIONS)
    ]


def coverage(rows: list[list[dict[str, Any]]], truths: list[float]) -> np.ndarray:
    """The proportion of intervals that hold the truth, by metric; NaN where there is none."""
    covered = np.full((REPETITIONS, METRICS), np.nan)
    for k, row in enumerate(rows):
        for i, (found, truth) in enumerate(zip(row, truths, strict=True)):
            if found["low"] is not None:
                covered[k, i] = found["low"] <= truth <= found["high"]
    told = (~np.isnan(covered)).sum(axis=0)
    proportions = np.where(told > 0, np.nansum(covered, axis=0) / np.maximum(told, 1), np.nan)
    for i, (found, proportion, count) in enumerate(zip(rows[0], proportions, told, strict=True)):
        separated = np.mean([row[i]["separated"] for row in rows])
        print(
            f"{found['second']:8} {found['metric_set']:10} {found['metric']:28} "
            f"covered {proportion:.3f} of {count} separated {separated:.3f}",
            file=sys.stderr,
        )
    pooled = np.nansum(covered) / told.sum()
    print(f"{rows[0][0]['second']}: {pooled:.4f} of all intervals cover the truth", file=sys.stderr)
    assert 0.93 <= pooled <= 0.97
    # 200 of 95 %: standard deviation 1.5 %; four of them below, among about 50 metrics.
    assert np.nanmin(proportions) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / REPETITIONS)
    return proportions


def test_two_drivers_of_one_kind_are_seldom_told_apart(cells: dict[str, CellRows]) -> None:
    rows = compared(cells, "other")
    coverage(rows, [0.0] * METRICS)
    false_alarms = np.mean([any(found["separated"] for found in row) for row in rows])
    print(f"false alarms after Holm's correction: {false_alarms:.3f}", file=sys.stderr)
    assert false_alarms <= 0.06


def test_a_difference_that_is_known_exactly_is_covered(cells: dict[str, CellRows]) -> None:
    rows = compared(cells, "faster")
    speeds = [[found for found in row if found["metric"] == "speed_mean"][-1] for row in rows]
    assert speeds[0]["metric_set"] == "standard-5"
    covered = np.mean([f["low"] <= -FASTER_MPS <= f["high"] for f in speeds])
    detectable = np.median([f["detectable"] for f in speeds])
    found = np.mean([f["high"] < 0 for f in speeds])
    print(
        f"faster: covered {covered:.3f}, seen {found:.3f} of {FASTER_MPS} m/s; said to see "
        f"{detectable:.2f} m/s in 80 %",
        file=sys.stderr,
    )
    assert covered == pytest.approx(0.95, abs=0.045)  # three standard deviations


def test_the_difference_of_two_kinds_of_drivers_is_covered_and_found(
    cells: dict[str, CellRows],
) -> None:
    scene = Suite.model_validate(SUITE).scene
    truths = to_dicts(compare([(cells["one"], cells["noisier"])], METRIC_SETS, scene, seed=0))
    rows = compared(cells, "noisier")
    coverage(rows, [found["difference"] for found in truths])
    found = np.mean([f["separated"] for row in rows for f in row if f["metric"] == "jerk_rms"])
    assert found > 0.95
