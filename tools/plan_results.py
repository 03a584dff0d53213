"""The test of docs/training-plan.md: `python tools/plan_results.py RUNS`.

RUNS holds the run folders of the suites in `suites/seeds`, each under the name of its suite. Egos
whose labels differ only in the seed are one training configuration: each value is the mean over its
seeds, with Student's t interval, and the value of the worst seed. Writes all values to
`docs/results/plan-test.csv` and prints the table of the main test and that of the other conditions.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from seeds import t_interval

from charms_bench.metrics import STANDARD
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished
from charms_bench.world.scene import Floats

ROOT = Path(__file__).parent.parent
Worst = Callable[[Floats], float]


def _furthest(low: float, high: float) -> Worst:
    """Of values that are to lie between two limits, the one that lies furthest outside."""
    return lambda values: float(max(values, key=lambda each: max(low - each, each - high)))


DRIVING: dict[str, tuple[str, str, Worst]] = {
    "crashed_at_fault": ("crashed at fault", ".1%", max),
    "crashed_episodes": ("crashed", ".1%", max),
    "speed_mean": ("speed, m/s", ".2f", min),
    "lane_changes_per_km": ("lane changes per km", ".2f", _furthest(0.1, 0.75)),
    "lane_changes_undone": ("undone", ".0%", max),
    "mean_acceleration_std": ("acceleration std, m/s²", ".2f", _furthest(0.2, 0.5)),
    "strong_acceleration_rate": ("above 1.1 m/s²", ".1%", max),
    "acceleration_reversals_per_min": ("reversals per minute", ".1f", _furthest(1.0, 6.0)),
    "centre_headway_below_1s": ("headway < 1 s", ".1%", _furthest(0.05, 0.21)),
}
"""Header and format of each metric, and which of the seeds' values is the worst."""
SEALED: dict[str, tuple[str, str, Worst]] = {
    "crashed_at_fault": ("crashed at fault", ".1%", max),
    "crashed_episodes": ("crashed", ".1%", max),
    "speed_mean": ("speed, m/s", ".2f", min),
    "lag_gap_mean": ("lag gap, m", ".1f", min),
    "imposed_braking_mean": ("imposed braking, m/s²", ".2f", max),
    "conflicts_per_1000km": ("conflicts per 1,000 km", ",.0f", max),
}
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
KEYS = ("condition", "traffic", "ego", "over the seeds")


MAIN = ("Human (I-75)", "IDM+MOBIL")
"""The traffics of the main test."""


def of_seeds(run: Path, condition: str) -> pl.DataFrame:
    """The metrics of every seed of every configuration, one row per traffic and seed."""
    finished = open_finished(run)
    names = DRIVING | SEALED
    metrics = [each for each in STANDARD.metrics if each.name in names]
    records: list[dict[str, Any]] = []
    for cell in finished.cells():
        ego, _, seed = cell.agent.partition(", seed ")
        sums = cell.sums(metrics, finished.suite.scene)
        pairs = zip(metrics, sums, strict=True)
        found = {metric.name: float(metric.value(each.sum(axis=0))) for metric, each in pairs}
        labels = {"condition": condition, "traffic": cell.traffic, "ego": ego}
        records.append({**labels, "seed": int(seed) if seed else None, **found})
    return pl.DataFrame(records, infer_schema_length=None).with_columns(
        pl.selectors.float().round_sig_figs(6)
    )


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


def main(runs: Path) -> None:
    """Writes the values and prints the tables."""
    values = pl.concat(
        of_seeds(runs / folder, condition)
        for folder, condition in CONDITIONS.items()
        if (runs / folder).is_dir()
    )
    values.write_csv(ROOT / "docs" / "results" / "plan-test.csv")
    is_main = (pl.col("condition") == CONDITIONS["seeds-main"]) & pl.col("traffic").is_in(MAIN)
    print(summary(values.filter(is_main), DRIVING, KEYS[1:]))
    shown = pl.col("ego").is_in(["IDM+MOBIL", "Stackelberg", "Human (I-75)", "CHARMS"])
    print(summary(values.filter(~is_main & shown), SEALED, KEYS))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/plan_results.py RUNS")
    main(Path(sys.argv[1]))
