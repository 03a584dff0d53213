"""The results of several training seeds of each configuration, for `tools/write_results.py`.

Of the egos of `suites/seeds.yaml`, those whose labels differ only in the seed are one training
configuration. Each value is the mean over its seeds, with Student's t interval, and the value of
the worst seed. `python tools/seeds.py` prints how often such an interval contains the mean of
several distributions.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from matplotlib.ticker import PercentFormatter
from scipy import special

from charms_bench.metrics import METRIC_SETS
from charms_bench.report.figures.drawing import SERIES, panels, save
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished
from charms_bench.runs.folder import RunFolder
from charms_bench.statistics.intervals import CONFIDENCE, Bounds
from charms_bench.world.scene import Floats

ROOT = Path(__file__).parent.parent
COLUMNS = {
    "crashed_episodes": ("standard", "episodes crashed", ".1%", max),
    "crashed_at_fault": ("standard", "crashed at fault", ".1%", max),
    "speed_mean": ("paper", "speed, m/s", ".2f", min),
    "ttc_below_3s": ("paper", "TTC < 3 s", ".3f", max),
    "acc_std": ("paper", "acceleration std, m/s²", ".2f", max),
    "harsh_acc_rate": ("paper", "harsh", ".3f", max),
    "conflicts_per_1000km": ("standard", "conflicts per 1,000 km", ",.0f", max),
    "lane_changes_per_km": ("standard", "lane changes per km", ".1f", None),
}
"""Metric set, header and format of each metric, and which of the seeds' values is the worst, if
any is better than another."""
SHARES = ("crashed_episodes", "crashed_at_fault", "ttc_below_3s", "harsh_acc_rate")
DRAWN = {"crashed_episodes": (0.002, 1.0), "ttc_below_3s": (0.005, 1.0)}
"""The metrics of the figure, and the smallest and largest value on their axes."""
SEEDS = 5
REPETITIONS = 200_000


def seeds_table(run: Path) -> str:
    """The table of configurations; also writes `docs/results/seeds.csv` and `docs/seeds.png`."""
    values = of_seeds(run)
    values.write_csv(ROOT / "docs" / "results" / "seeds.csv")
    draw_seeds(values, ROOT / "docs" / "seeds.png")
    return f"{summary(values)}\n{RunFolder(run).suite().note}\n"


def of_seeds(run: Path) -> pl.DataFrame:
    """The metrics of every seed of every configuration, one row per seed."""
    finished = open_finished(run)
    known = {(found.name, each.name): each for found in METRIC_SETS for each in found.metrics}
    metrics = [known[of, name] for name, (of, *_) in COLUMNS.items()]
    networks = {ego.title: ROOT / "suites" / ego.agent.name for ego in finished.suite.egos}
    records: list[dict[str, Any]] = []
    for cell in finished.cells():
        configuration, _, seed = cell.agent.rpartition(", seed ")
        sums = cell.sums(metrics, finished.suite.scene)
        pairs = zip(metrics, sums, strict=True)
        found = {metric.name: float(metric.value(each.sum(axis=0))) for metric, each in pairs}
        minutes = _process_minutes(networks[cell.agent])
        labels = {"configuration": configuration, "seed": int(seed)}
        records.append({**labels, **found, "process_minutes": minutes})
    return pl.DataFrame(records, infer_schema_length=None).with_columns(
        pl.selectors.float().round_sig_figs(6)
    )


def summary(values: pl.DataFrame) -> str:
    """The table of configurations from the metrics of every seed, as Markdown."""
    keys = ("training configuration", "over the seeds")
    records: list[dict[str, Any]] = []
    for (name,), part in values.group_by("configuration", maintain_order=True):
        mean: dict[str, Any] = dict(zip(keys, (name, "mean [t interval]"), strict=True))
        worst: dict[str, Any] = dict(zip(keys, ("", "worst seed"), strict=True))
        for metric, (_, header, _, worst_of) in COLUMNS.items():
            found = part[metric].to_numpy()
            low, high = t_interval(found)
            highest = 1.0 if metric in SHARES else np.inf
            mean[header] = Number(found.mean(), max(low, 0.0), min(high, highest), len(found))
            worst[header] = worst_of(found) if worst_of else None
        mean["process-minutes"] = part["process_minutes"].mean()
        records += [mean, worst]
    forms = {header: form for _, header, form, _ in COLUMNS.values()} | {"process-minutes": ".1f"}
    return markdown(Table.plain(records, keys, forms))


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


def _process_minutes(network: Path) -> float | None:
    """The processor time of the training of a network and of the one that it fine-tunes."""
    made = json.loads(network.with_suffix(".json").read_text(encoding="utf-8"))
    before = made.get("starts_from", {}).get("stage")
    start = _process_minutes(network.with_stem(before)) if before else 0.0
    if start is None or "cpu_s" not in made:
        return None  # trained before it was recorded
    return start + float(made["cpu_s"]) / 60


def draw_seeds(values: pl.DataFrame, path: Path) -> None:
    """Draws every seed of every configuration as a point."""
    names = values["configuration"].unique(maintain_order=True).to_list()
    places = [names.index(name) for name in values["configuration"]]
    figure, axes = panels(len(DRAWN), 4.2, 3.2)
    for ax, (metric, ends) in zip(axes, DRAWN.items(), strict=True):
        look = {"color": SERIES[0], "alpha": 0.6, "markersize": 5, "clip_on": False}
        ax.plot(values[metric], places, "o", **look)
        ax.set(xlabel=COLUMNS[metric][1], xscale="log", xlim=ends)
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_yticks(range(len(names)), names if ax is axes[0] else [""] * len(names))
        ax.grid(axis="y", linewidth=0.4, alpha=0.4)
        ax.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=1))
    save(figure, path)


if __name__ == "__main__":
    print(coverage_table())
