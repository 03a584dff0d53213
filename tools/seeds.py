"""The test of docs/training-plan.md, for `tools/write_results.py`.

Egos of `suites/seeds.yaml` and of the folder `suites/seeds` whose labels differ only in the seed
are one training configuration. Each value is the mean over its seeds, with Student's t interval,
and the value of the worst seed. `python tools/seeds.py` prints how often such an interval contains
the mean of several distributions.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy import special

from charms_bench.metrics import STANDARD
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished
from charms_bench.statistics.intervals import CONFIDENCE, Bounds
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
    "seeds": "3 lanes, density 1",
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
SEEDS = 10
REPETITIONS = 200_000


def seeds_table(run: Path) -> str:
    """The table of the main test; writes `docs/results/seeds.csv`, which has all conditions."""
    values = pl.concat(
        of_seeds(run.parent / folder, condition)
        for folder, condition in CONDITIONS.items()
        if (run.parent / folder).is_dir()
    )
    values.write_csv(ROOT / "docs" / "results" / "seeds.csv")
    is_main = (pl.col("condition") == CONDITIONS["seeds"]) & pl.col("traffic").is_in(MAIN)
    return f"{summary(values.filter(is_main), DRIVING, KEYS[1:])}\n"


def transfer_seeds_table(run: Path) -> str:
    """The table of the other conditions, in which training seeds are compared with IDM+MOBIL."""
    values = pl.read_csv(ROOT / "docs" / "results" / "seeds.csv")
    is_main = (pl.col("condition") == CONDITIONS["seeds"]) & pl.col("traffic").is_in(MAIN)
    shown = pl.col("ego").is_in(["IDM+MOBIL", "Stackelberg", "Human (I-75)", "CHARMS"])
    return f"{summary(values.filter(~is_main & shown), SEALED, KEYS)}\n"


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


def t_interval(values: Floats) -> Bounds:
    """Student's t interval of the mean of independent values (..., n), at a nominal 95 %."""
    n = values.shape[-1]
    t = special.stdtrit(n - 1, (1 + CONFIDENCE) / 2)
    margin = t * values.std(axis=-1, ddof=1) / np.sqrt(n)
    mean = values.mean(axis=-1)
    return mean - margin, mean + margin


def coverage() -> dict[str, float]:
    """How often the t interval of five values contains their mean, by distribution."""
    rng = np.random.default_rng(0)
    normal = rng.standard_normal((REPETITIONS, SEEDS))
    is_bad = rng.random(normal.shape) < 1 / SEEDS
    samples = {
        "normal": (normal, 0.0),
        "lognormal, σ = 0.5": (np.exp(0.5 * normal), np.exp(0.125)),
        "lognormal, σ = 1": (np.exp(normal), np.exp(0.5)),
        "normal, but each seed is bad with probability 1/5, by 10 standard deviations": (
            normal + 10 * is_bad,
            10 / SEEDS,
        ),
    }
    found = {}
    for name, (values, mean) in samples.items():
        low, high = t_interval(values)
        found[name] = float(((low <= mean) & (mean <= high)).mean())
    return found


def coverage_table(run: Path | None = None) -> str:
    """The simulated coverage as Markdown; it needs no run."""
    key, share = "distribution of the seeds", "t intervals that contain the mean"
    records = [{key: name, share: found} for name, found in coverage().items()]
    return markdown(Table.plain(records, (key,), {share: ".1%"}))


if __name__ == "__main__":
    print(coverage_table())
