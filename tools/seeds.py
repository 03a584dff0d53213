"""The results of several training seeds of each recipe, for `tools/write_results.py`.

Of the egos of `suites/seeds.yaml`, those whose labels differ only in the seed are one recipe. Each
value is the interquartile mean over its seeds, without the lowest and the highest quarter (Agarwal
et al. 2021, NeurIPS). Its interval is that of a bootstrap over seeds, and over the episodes of each
seed that is drawn.
"""

from pathlib import Path

import numpy as np
from scipy.stats import trim_mean

from charms_bench.metrics import METRIC_SETS
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Column, Number, Row, Table
from charms_bench.runs.finished import open_finished
from charms_bench.statistics.intervals import CONFIDENCE, resampled_totals

TRIMMED = 0.25
REPLICATES = 20_000
COLUMNS = {
    "episodes crashed": ("standard", "crashed_episodes", ".1%"),
    "speed, m/s": ("paper", "speed_mean", ".2f"),
    "TTC < 3 s": ("paper", "ttc_below_3s", ".3f"),
    "acceleration std, m/s²": ("paper", "acc_std", ".2f"),
    "harsh": ("paper", "harsh_acc_rate", ".3f"),
    "conflicts per 1,000 km": ("standard", "conflicts_per_1000km", ",.0f"),
    "lane changes per km": ("standard", "lane_changes_per_km", ".1f"),
}
"""Header, metric set, metric and format of each column."""


def seeds_table(run: Path) -> str:
    """The table of recipes, and the share of crashed episodes of each seed."""
    finished = open_finished(run)
    known = {(found.name, each.name): each for found in METRIC_SETS for each in found.metrics}
    metrics = [known[of, name] for of, name, _ in COLUMNS.values()]
    rng = np.random.default_rng(finished.suite.seed)
    values: dict[str, list[list[float]]] = {}
    spreads: dict[str, list[list[np.ndarray]]] = {}
    for cell in finished.cells():
        recipe = cell.agent.rpartition(", seed ")[0]
        sums = cell.sums(metrics, finished.suite.scene)
        ends = np.cumsum([each.shape[1] for each in sums])[:-1]
        resampled = np.split(resampled_totals(sums, rng), ends, axis=1)
        pairs = zip(metrics, sums, strict=True)
        found = [float(metric.value(each.sum(axis=0))) for metric, each in pairs]
        values.setdefault(recipe, []).append(found)
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
        rows.append(Row((recipe,), tuple(numbers)))
    columns = tuple(Column(header, form=form) for header, (_, _, form) in COLUMNS.items())
    table = Table("seeds", finished.suite.title, ("recipe",), columns, tuple(rows))
    crashed = [
        f"- {recipe}: " + ", ".join(f"{each[0]:.1%}" for each in of_seeds).replace("%", " %")
        for recipe, of_seeds in values.items()
    ]
    return f"{markdown(table)}\nEpisodes crashed, by seed:\n\n" + "\n".join(crashed) + "\n"
