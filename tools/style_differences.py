"""The paper's statements about the styles, from a finished run of `suites/styles.yaml`.

Each of the paper's statements about the styles is a difference between two groups of styles, given
as an effect size: the difference of the means of episodes in pooled standard deviations (Cohen
1988), with a bootstrap interval over episodes.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.metrics.rows import join_rows
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Column, Number, Row, Table
from charms_bench.runs.finished import open_finished

REPLICATES = 2_000
HARSH_MPS2 = 2.5
STATEMENTS = (
    # statement, feature, styles that have more of it, styles that have less
    ("efficient styles are faster", "speed_mean", "efficient", "safe"),
    ("safe styles keep longer headways", "dhw_mean", "safe", "efficient"),
    ("safe styles are less often harsh", "harsh", "efficient", "safe"),
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
FEATURES = {
    "speed_mean": pl.col("speed").mean(),
    "speed_std": pl.col("speed").std(),
    "acc_std": pl.col("acceleration").std(),
    "harsh": (pl.col("acceleration").abs() > HARSH_MPS2).mean(),
    "dhw_mean": pl.col("leader_distance").mean(),
}
"""What is measured of each episode, in the decisions with a leader within 50 m."""
Values = NDArray[np.float64]


def style_differences(run: Path) -> str:
    """A statement per row, as Markdown."""
    finished = open_finished(run)
    tables = {}
    for cell in finished.cells():
        rows = join_rows(cell.episodes, cell.steps, finished.suite.scene)
        rows = rows.filter("driving", "logged")
        aggregated = [each.alias(name) for name, each in FEATURES.items()]
        tables[cell.agent.lower()] = rows.group_by("episode").agg(aggregated).sort("episode")
    rng = np.random.default_rng(finished.suite.seed)
    return markdown(_effects(tables, rng))


def _effects(tables: Mapping[str, pl.DataFrame], rng: np.random.Generator) -> Table:
    rows = []
    for statement, feature, more, less in STATEMENTS:
        groups = [
            [
                table[feature].drop_nulls().drop_nans().to_numpy()
                for style, table in tables.items()
                if set(style.split("-")) & set(words.split())
            ]
            for words in (more, less)
        ]
        drawn = [
            _effect(*([rng.choice(each, each.size) for each in group] for group in groups))
            for _ in range(REPLICATES)
        ]
        low, high = np.quantile(drawn, [0.025, 0.975])
        n = sum(each.size for group in groups for each in group)
        rows.append(Row((statement,), (Number(_effect(*groups), float(low), float(high), n),)))
    column = Column("effect size", form=".2f")
    return Table("style-differences", "", ("statement",), (column,), tuple(rows))


def _effect(more: Sequence[Values], less: Sequence[Values]) -> float:
    """Difference of the means of the styles' means, in pooled standard deviations of episodes."""
    difference = np.mean([each.mean() for each in more]) - np.mean([each.mean() for each in less])
    variance = np.mean([each.var(ddof=1) for each in (*more, *less)])
    return float(difference / np.sqrt(variance))


if __name__ == "__main__":
    print(style_differences(Path(sys.argv[1])))
