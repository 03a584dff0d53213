"""Counts the crashes of `suites/rare.yaml` in plain episodes, to compare `charms-bench rare` with.

    python tools/rare_plain.py [EPISODES]

By default, the episodes have the seeds 0 to 999,999, which takes about an hour on one core. It
writes docs/results/rare-plain.csv, which `write_results.py` reads.
"""

import sys
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.engine.events import Crash, lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.runs.suite import load_suite

ROOT = Path(__file__).parents[1]
AT_ONCE = 1000


def main(episodes: int) -> None:
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
    found = pl.DataFrame({"episodes": [episodes], "crashed": [crashed]})
    found.write_csv(ROOT / "docs" / "results" / "rare-plain.csv")
    print(f"{crashed} of {episodes:,} episodes crashed")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
