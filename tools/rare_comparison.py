"""Estimates of `charms-bench rare` beside plain episodes.

`write_results.py` compares the folders `RUNS/rare` and `OTHERS` with the plain episodes of
`suites/rare.yaml`. To count an event in the plain episodes of a suite, from the suite's seed on,
and to estimate its probability with the seeds 0, 1, ...:

    python tools/rare_comparison.py SUITE EVENT EPISODES ESTIMATES

The counts are in docs/results/rare-plain.csv, and how many intervals hold them in the table
`rare-intervals` of docs/stress-tests.md. An estimate has the default `--runs` and `--samples`, and
its folder is `runs/rare-comparison/SUITE-EVENT-SEED`, so the same command continues. The docs say
which suites and events were counted; a million episodes of `suites/rare.yaml` take about an hour on
one core.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
from result_pages import RESULTS, ROOT, keep, table_named

from charms_bench import rare
from charms_bench.engine.events import lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.rare_table import plain_episodes
from charms_bench.report.table import Table
from charms_bench.runs.rare_task import event_of
from charms_bench.runs.shard import engine_on
from charms_bench.runs.suite import Suite, load_suite
from charms_bench.statistics.intervals import wilson

PLAIN = RESULTS / "rare-plain.csv"
COUNTED = {"suite": pl.String, "event": pl.String, "episodes": pl.Int64, "happened": pl.Int64}
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
    ((_, _, episodes, crashed),) = pl.read_csv(PLAIN).filter(pl.col("suite") == "rare").rows()
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


def count_plain(suite: Suite, event: str, episodes: int) -> int:
    """In how many plain episodes of a suite's only cell an event happens."""
    (cell,) = suite.cells
    agents = {cell.ego.agent.key: make_agent(cell.ego.agent.name)}
    traffic, definition = cell.traffic.traffic.make(), event_of(event)
    engine = engine_on(cell.scene)
    simulation = Simulation(cell.scene, AT_ONCE, cell.ego.agent.key, traffic, agents, engine)
    happened = 0
    for first in range(suite.seed, suite.seed + episodes, AT_ONCE):
        simulation.reset(np.arange(first, first + AT_ONCE, dtype=np.uint64))
        happened += int((lowest_levels(simulation, definition) <= 0).sum())
    return happened


def compare(path: Path, event: str, episodes: int, estimates: int) -> None:
    """Counts an event and estimates its probability, and adds both to the tables."""
    name, counted = path.stem, pl.read_csv(PLAIN)
    asked = (pl.col("suite") == name) & (pl.col("event") == event)
    found = counted.filter(asked & (pl.col("episodes") == episodes))
    if found.is_empty():
        happened = count_plain(load_suite(path), event, episodes)
        found = pl.DataFrame([(name, event, episodes, happened)], schema=COUNTED, orient="row")
        pl.concat([counted.filter(~asked), found]).write_csv(PLAIN)
    happened = found["happened"].item()
    print(f"{event} in {happened} of {episodes:,} episodes of {name}", flush=True)
    plain = Number(happened / episodes, *wilson(happened, episodes), episodes)
    made = []
    for seed in range(estimates):
        folder = ROOT / "runs" / "rare-comparison" / f"{name}-{event.replace(':', '-')}-{seed}"
        (row,) = rare(path, event, folder, seed=seed, workers=1).table.rows
        made.append(row.numbers[0])
        print(f"seed {seed}: {made[-1]}", flush=True)
    if made:
        key = f"| {name} | `{event}` |"
        lines = table_named("rare-intervals").splitlines()
        kept = [line for line in lines if not line.startswith(key)]
        keep("rare-intervals", "\n".join([*kept, key + intervals(plain, made)]) + "\n")


def intervals(plain: Number, made: Sequence[Number]) -> str:
    """The rest of a line of the table of intervals."""
    low, high = np.array([(each.low, each.high) for each in made]).T
    mean = np.mean([each.value for each in made])
    covering = int(((low <= plain.value) & (plain.value <= high)).sum())
    return (
        f" {plain.value:.2e} [{plain.low:.2e}, {plain.high:.2e}] | {mean:.2e} | "
        f"{np.mean([each.n for each in made]):,.0f} | {np.median(high / low):.1f} | "
        f"{covering} of {len(made)} |"
    )


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit("usage: python tools/rare_comparison.py SUITE EVENT EPISODES ESTIMATES")
    compare(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
