"""The results of several training seeds of each recipe, for `tools/write_results.py`.

Of the egos of `suites/seeds.yaml`, those whose labels differ only in the seed are one recipe. Each
value is the interquartile mean over its seeds, without the lowest and the highest quarter (Agarwal
et al. 2021, NeurIPS). Its interval is that of a bootstrap over seeds, and over the episodes of each
seed that is drawn.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.ticker import PercentFormatter
from scipy.stats import trim_mean

from charms_bench.metrics import METRIC_SETS
from charms_bench.report.figures.drawing import panels, save
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Column, Number, Row, Table
from charms_bench.runs.finished import open_finished
from charms_bench.statistics.intervals import CONFIDENCE, resampled_totals

ROOT = Path(__file__).parent.parent
TRIMMED = 0.25
REPLICATES = 20_000
COLUMNS = {
    "episodes crashed": ("standard", "crashed_episodes", ".1%"),
    "crashed at fault": ("standard", "crashed_at_fault", ".1%"),
    "speed, m/s": ("paper", "speed_mean", ".2f"),
    "TTC < 3 s": ("paper", "ttc_below_3s", ".3f"),
    "acceleration std, m/s²": ("paper", "acc_std", ".2f"),
    "harsh": ("paper", "harsh_acc_rate", ".3f"),
    "conflicts per 1,000 km": ("standard", "conflicts_per_1000km", ",.0f"),
    "lane changes per km": ("standard", "lane_changes_per_km", ".1f"),
}
"""Header, metric set, metric and format of each column."""
PROFILES = {"episodes crashed": (0.002, 1.0), "TTC < 3 s": (0.01, 1.0)}
"""The columns with a performance profile, and the smallest and largest value that are drawn."""


def seeds_table(run: Path) -> str:
    """The table of recipes, the crashed episodes of each seed, and `docs/profiles.png`."""
    finished = open_finished(run)
    known = {(found.name, each.name): each for found in METRIC_SETS for each in found.metrics}
    metrics = [known[of, name] for of, name, _ in COLUMNS.values()]
    rng = np.random.default_rng(finished.suite.seed)
    values: dict[str, list[list[float]]] = {}
    spreads: dict[str, list[list[np.ndarray]]] = {}
    minutes: dict[str, list[float | None]] = {}
    for cell in finished.cells():
        recipe = cell.agent.rpartition(", seed ")[0]
        sums = cell.sums(metrics, finished.suite.scene)
        ends = np.cumsum([each.shape[1] for each in sums])[:-1]
        resampled = np.split(resampled_totals(sums, rng), ends, axis=1)
        pairs = zip(metrics, sums, strict=True)
        found = [float(metric.value(each.sum(axis=0))) for metric, each in pairs]
        values.setdefault(recipe, []).append(found)
        egos = finished.suite.egos
        name = next(ego.agent.name for ego in egos if ego.title == cell.agent)
        network = ROOT / "suites" / name
        minutes.setdefault(recipe, []).append(_process_minutes(network))
        spreads.setdefault(recipe, []).append(
            [metric.value(each) for metric, each in zip(metrics, resampled, strict=True)]
        )
    rows = []
    for recipe, of_seeds in values.items():
        n = len(of_seeds)
        drawn = rng.integers(n, size=(REPLICATES, n))
        numbers = []
        for m in range(len(metrics)):
            spread = np.stack([each[m] for each in spreads[recipe]])
            picked = spread[drawn, rng.integers(spread.shape[1], size=drawn.shape)]
            tail = (1 - CONFIDENCE) / 2
            low, high = np.quantile(trim_mean(picked, TRIMMED, axis=1), [tail, 1 - tail])
            mean = trim_mean([each[m] for each in of_seeds], TRIMMED)
            numbers.append(Number(float(mean), float(low), float(high), n))
        known_minutes = [each for each in minutes[recipe] if each is not None]
        numbers.append(Number(float(np.mean(known_minutes))) if known_minutes else Number())
        rows.append(Row((recipe,), tuple(numbers)))
    columns = (
        *(Column(header, form=form) for header, (_, _, form) in COLUMNS.items()),
        Column("process-minutes", form=".1f"),
    )
    table = Table("seeds", finished.suite.title, ("recipe",), columns, tuple(rows))
    _draw_profiles(spreads, ROOT / "docs" / "profiles.png", rng)
    crashed = [
        f"- {recipe}: " + ", ".join(f"{each[0]:.1%}" for each in of_seeds).replace("%", " %")
        for recipe, of_seeds in values.items()
    ]
    return f"{markdown(table)}\nEpisodes crashed, by seed:\n\n" + "\n".join(crashed) + "\n"


def _process_minutes(network: Path) -> float | None:
    """The processor time of the training of a network and of the one that it fine-tunes."""
    made = json.loads(network.with_suffix(".json").read_text(encoding="utf-8"))
    before = made.get("starts_from", {}).get("stage")
    start = _process_minutes(network.with_stem(before)) if before else 0.0
    if start is None or "cpu_s" not in made:
        return None  # trained before it was recorded
    return start + float(made["cpu_s"]) / 60


def _draw_profiles(
    spreads: Mapping[str, list[list[np.ndarray]]], path: Path, rng: np.random.Generator
) -> None:
    """Draws performance profiles: the share of seeds below each value, with bootstrap bands."""
    figure, axes = panels(len(PROFILES), 4.2, 3.2)
    for ax, (header, ends) in zip(axes, PROFILES.items(), strict=True):
        m, levels = list(COLUMNS).index(header), np.geomspace(*ends, 201)
        for k, (recipe, of_seeds) in enumerate(spreads.items()):
            spread = np.stack([each[m] for each in of_seeds])
            n = len(spread)
            drawn = rng.integers(n, size=(2_000, n))
            picked = spread[drawn, rng.integers(spread.shape[1], size=drawn.shape)]
            below = (picked[:, :, None] <= levels).mean(axis=1)
            low, high = np.quantile(below, [0.025, 0.975], axis=0)
            ax.plot(
                levels,
                (spread[:, :, None] <= levels).mean(axis=(0, 1)),
                color=f"C{k}",
                label=recipe,
            )
            ax.fill_between(levels, low, high, color=f"C{k}", alpha=0.12, linewidth=0)
        ax.set_xlabel(header)
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=1))
        ax.set_ylim(0, 1.02)
    axes[0].set_ylabel("share of training seeds at or below")
    axes[-1].legend(fontsize="x-small", frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    save(figure, path)
