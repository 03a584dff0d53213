"""The paper's statements about the styles, from a finished run of `suites/styles.yaml`.

Each of the paper's statements compares two groups of styles. It is tested by two statistics. The
first is the paper's own: the metric of its Table III, over all decisions of all episodes of a
style, averaged over the styles of the group. The second is an effect size: the difference of the
means of episodes in pooled standard deviations (Cohen 1988). Both have bootstrap intervals over
episodes, which the styles share.
"""

import sys
from pathlib import Path

import numpy as np

from charms_bench.metrics import PAPER, Metric
from charms_bench.metrics.metric import standard_deviation
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.pairs_table import guess_summary
from charms_bench.report.table import Column, Row, Table
from charms_bench.runs.finished_run import open_finished
from charms_bench.statistics.intervals import resample
from charms_bench.world.scene import Floats

STATEMENTS = (
    # statement, metric of the paper's table, styles that have more of it, styles that have less
    ("efficient styles are faster", "speed_mean", "efficient", "safe"),
    ("safe styles keep longer headways", "dhw_mean", "safe", "efficient"),
    ("safe styles are less often harsh", "harsh_acc_rate", "efficient", "safe"),
    (
        "the speed of competitive and altruistic styles varies more",
        "speed_std",
        "competitive altruistic",
        "egoistic prosocial",
    ),
    (
        "the acceleration of competitive and altruistic styles varies more",
        "acc_std",
        "competitive altruistic",
        "egoistic prosocial",
    ),
)
COLUMNS = (
    Column("styles that should have more", form="margin"),
    Column("other styles", form="margin"),
    Column("difference", form="margin", signed=True),
    Column("effect size, by episode", form=".2f"),
)


def style_differences(run: Path) -> str:
    """A statement per row, as Markdown, and how well the style of an episode is guessed."""
    finished = open_finished(run)
    cells = list(finished.cells())
    known = {metric.name: metric for metric in PAPER.metrics}
    names = list(dict.fromkeys(metric for _, metric, _, _ in STATEMENTS))
    of_cells = [cell.sums([known[name] for name in names], finished.suite.scene) for cell in cells]
    sums = {name: np.stack([each[m] for each in of_cells]) for m, name in enumerate(names)}
    weights = resample(np.random.default_rng(finished.suite.seed), cells[0].size)
    rows = []
    for statement, metric, *words in STATEMENTS:
        more, less = (
            [
                sums[metric][k]
                for k, cell in enumerate(cells)
                if set(cell.agent.lower().split("-")) & set(group.split())
            ]
            for group in words
        )
        numbers = _compared(known[metric], np.stack(more), np.stack(less), weights)
        rows.append(Row((statement,), numbers))
    table = markdown(Table("style-differences", "", ("statement",), COLUMNS, tuple(rows)))
    return f"{table}\n{guess_summary(finished.suite, cells)}\n"


def _compared(metric: Metric, more: Floats, less: Floats, weights: Floats) -> tuple[Number, ...]:
    """Both groups, their difference and its effect size, from sums [styles, E, k]."""
    pooled = [metric.value(weights @ each).mean(axis=0) for each in (more, less)]
    found = [float(metric.value(each.sum(axis=1)).mean()) for each in (more, less)]
    by_episode = [_by_episode(metric, each) for each in (more, less)]
    effects = np.array([_effect(*by_episode, each) for each in weights])
    effect = _effect(*by_episode, np.ones(weights.shape[1]))
    return (
        _number(found[0], pooled[0]),
        _number(found[1], pooled[1]),
        _number(found[0] - found[1], pooled[0] - pooled[1]),
        _number(effect, effects),
    )


def _by_episode(metric: Metric, sums: Floats) -> Floats:
    """The metric of each episode; of an episode, a standard deviation is that of a sample."""
    values = metric.value(sums)
    if metric.value is not standard_deviation:
        return values
    n = np.where(sums[..., 0] > 1, sums[..., 0], np.nan)
    return values * np.sqrt(n / (n - 1))


def _number(value: float, resampled: Floats) -> Number:
    low, high = np.quantile(resampled, [0.025, 0.975])
    return Number(value, float(low), float(high))


def _effect(more: Floats, less: Floats, weights: Floats) -> float:
    """The difference of means of styles in pooled standard deviations, of values [styles, E]."""
    means, variances = [], []
    for style in (*more, *less):
        is_known = ~np.isnan(style)
        values, weight = style[is_known], weights[is_known]
        mean = np.average(values, weights=weight)
        means.append(mean)
        variances.append(np.average((values - mean) ** 2, weights=weight))
    difference = np.mean(means[: len(more)]) - np.mean(means[len(more) :])
    return float(difference / np.sqrt(np.mean(variances)))


if __name__ == "__main__":
    print(style_differences(Path(sys.argv[1])))
