"""Estimates of `charms-bench rare suites/rare.yaml` beside plain episodes, for `write_results.py`.

The folders are `RUNS/rare` and those of `OTHERS`. The plain episodes are those that
`rare_plain.py` has counted in docs/results/rare-plain.csv.
"""

from pathlib import Path

import polars as pl

from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.rare_table import plain_episodes
from charms_bench.report.table import Column, Row, Table
from charms_bench.statistics.intervals import wilson

PLAIN = Path(__file__).parents[1] / "docs" / "results" / "rare-plain.csv"
OTHERS = {
    "rare-50-runs": "`--runs 50`",
    "rare-small": "`--runs 50 --samples 200`",
}
"""Other run folders of the suite, and the options that made them."""
FORMS = {
    "probability": ".2e",
    "runs": ",.0f",
    "levels": ",.0f",
    "episodes": ",.0f",
    "plain_episodes": ",.0f",
}


def estimated(run: Path) -> dict[str, Number]:
    """The numbers of a folder's only cell, by column."""
    rows = pl.read_csv(run / "tables" / "rare-rare-crash.csv").to_dicts()
    return {row["name"]: Number(row["value"], row["low"], row["high"], row["n"]) for row in rows}


def rare_estimate(run: Path) -> str:
    """The table of the command, as Markdown."""
    found = estimated(run)
    columns = tuple(Column(name.replace("_", " "), form=form) for name, form in FORMS.items())
    row = Row(("IDM+MOBIL",), tuple(found[name] for name in FORMS))
    return markdown(Table("rare", "", ("agent",), columns, (row,)))


def rare_comparison(run: Path) -> str:
    """One row per way to estimate, with the plain episodes that give an interval as narrow."""
    ((episodes, crashed),) = pl.read_csv(PLAIN).rows()
    low, high = wilson(crashed, episodes)
    plain = Number(crashed / episodes, low, high, episodes)
    rows = [_row("plain episodes", plain, episodes)]
    for name, said in {"rare": "`charms-bench rare`", **OTHERS}.items():
        if (run.parent / name).is_dir():
            found = estimated(run.parent / name)
            rows.append(_row(said, found["probability"], int(found["episodes"].value or 0)))
    columns = (
        Column("probability", form=".2e"),
        Column("episodes", form=",.0f"),
        Column("plain episodes for the same width", form=",.0f"),
        Column("ratio", form=".1f"),
    )
    return markdown(Table("rare-comparison", "", ("method",), columns, tuple(rows)))


def _row(said: str, probability: Number, episodes: int) -> Row:
    plain = plain_episodes(probability)
    ratio = None if plain is None else plain / episodes
    return Row((said,), (probability, Number(episodes), Number(plain), Number(ratio)))
