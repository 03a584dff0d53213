"""Estimates of `charms-bench rare suites/rare.yaml` beside plain episodes, for `write_results.py`.

The folders are `RUNS/rare` and those of `OTHERS`. To count the crashes in plain episodes:

    python tools/rare_comparison.py [EPISODES]

By default, the episodes have the seeds 0 to 999,999, which takes about an hour on one core. It
writes docs/results/rare-plain.csv.
"""

import sys
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.engine.events import Crash, lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.rare_table import plain_episodes
from charms_bench.report.table import Table
from charms_bench.runs.suite import load_suite
from charms_bench.statistics.intervals import wilson

ROOT = Path(__file__).parents[1]
PLAIN = ROOT / "docs" / "results" / "rare-plain.csv"
AT_ONCE = 1000
OTHERS = {"rare-50-runs": "`--runs 50`", "rare-small": "`--runs 50 --samples 200`"}
"""Other run folders of the suite, and the options that made them."""
PLAIN_EPISODES = "plain episodes for the same width"
FORMS = {
    "probability": ".2e",
    **dict.fromkeys(("runs", "levels", "episodes", "plain_episodes"), ",.0f"),
}


def estimated(run: Path) -> dict[str, Number]:
    """The numbers of a folder's only cell, by column."""
    rows = pl.read_csv(run / "tables" / "rare-rare-crash.csv").to_dicts()
    return {row["name"]: Number(row["value"], row["low"], row["high"], row["n"]) for row in rows}


def rare_estimate(run: Path) -> str:
    """The table of the command, as Markdown."""
    return markdown(Table.plain([{"agent": "IDM+MOBIL", **estimated(run)}], ("agent",), FORMS))


def rare_comparison(run: Path) -> str:
    """One row per way to estimate, with the plain episodes that give an interval as narrow."""
    ((episodes, crashed),) = pl.read_csv(PLAIN).rows()
    low, high = wilson(crashed, episodes)
    plain = Number(crashed / episodes, low, high, episodes)
    records = [_record("plain episodes", plain, episodes)]
    for name, said in {"rare": "`charms-bench rare`", **OTHERS}.items():
        if (run.parent / name).is_dir():
            found = estimated(run.parent / name)
            records.append(_record(said, found["probability"], int(found["episodes"].value or 0)))
    forms = {"probability": ".2e", "episodes": ",.0f", PLAIN_EPISODES: ",.0f", "ratio": ".1f"}
    return markdown(Table.plain(records, ("method",), forms))


def _record(said: str, probability: Number, episodes: int) -> dict[str, object]:
    plain = plain_episodes(probability)
    ratio = None if plain is None else plain / episodes
    numbers = {"probability": probability, "episodes": episodes, PLAIN_EPISODES: plain}
    return {"method": said, **numbers, "ratio": ratio}


def count_plain(episodes: int) -> None:
    """Simulates the episodes and writes how many crashed."""
    suite = load_suite(ROOT / "suites" / "rare.yaml")
    (cell,) = suite.cells
    agents = {"idm_mobil": make_agent("idm_mobil")}
    traffic = cell.traffic.traffic.make()
    simulation = Simulation(suite.scene, AT_ONCE, cell.ego.agent.key, traffic, agents)
    crashed = 0
    for first in range(0, episodes, AT_ONCE):
        simulation.reset(np.arange(first, first + AT_ONCE, dtype=np.uint64))
        crashed += int((lowest_levels(simulation, Crash()) <= 0).sum())
    pl.DataFrame({"episodes": [episodes], "crashed": [crashed]}).write_csv(PLAIN)
    print(f"{crashed} of {episodes:,} episodes crashed")


if __name__ == "__main__":
    count_plain(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
