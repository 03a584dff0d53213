"""Tunes IDM+MOBIL that gives way for roads, and drives it; see docs/training-plan-roads.md.

    python tools/roads_tuned.py FOLDER

Draws 26 trials with each seed of the ablations, drives them, and drives the best one of each seed
in the ablations' own test. `write_results.py roads-ablations FOLDER` adds it to the table.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from plan_roads import SEED
from plan_roads_values import best_trial
from result_pages import keep
from roads_ablations import SEEDS, TUNED, run

from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table

TRIALS, EPISODES, FIRST_EPISODE = 26, 100, 986_000_000
"""Each seed has episodes of its own."""
RANGES = {
    "critical": (0.0, 1.2),
    "time_headway_s": (0.4, 1.6),
    "acceleration_mps2": (1.0, 4.0),
    "deceleration_mps2": (2.0, 6.0),
    "jam_distance_m": (6.0, 12.0),
    "imposed_braking_mps2": (1.0, 5.0),
}
"""The first trial has the defaults of `yielding_idm_mobil`; the others are drawn from these."""


def trials(seed: int) -> list[dict[str, float]]:
    """The options of each trial."""
    rng = np.random.default_rng(seed)
    drawn = [
        {name: round(float(rng.uniform(*bounds)), 3) for name, bounds in RANGES.items()}
        for _ in range(TRIALS - 1)
    ]
    return [{}, *drawn]


def chosen(folder: Path, seed: int) -> dict[str, float]:
    """The options of the trial with the largest mean of goal reached minus at fault."""
    options = trials(seed)
    egos = [_ego(each, f"trial{SEED}{k}") for k, each in enumerate(options)]
    first = FIRST_EPISODE + 1000 * (seed - SEEDS[0])
    run(folder, f"trials-{seed}", {"egos": egos, "seed": first, "episodes": EPISODES})
    return options[best_trial(folder, f"trials-{seed}")]


def _ego(options: dict[str, float], label: str) -> dict[str, Any]:
    return {"agent": {"name": "yielding_idm_mobil", "options": options}, "label": label}


def tune(folder: Path) -> None:
    """Tunes with each seed, drives what was chosen, and writes which options that is."""
    found = {seed: chosen(folder, seed) for seed in SEEDS}
    egos = [_ego(options, f"{TUNED}{SEED}{seed}") for seed, options in found.items()]
    run(folder, "ablations", {"egos": egos})
    rows = [
        {"seed": str(seed), **{name: options.get(name) for name in RANGES}}
        for seed, options in found.items()
    ]
    keep("plan-roads-tuned", markdown(Table.plain(rows, ("seed",), dict.fromkeys(RANGES, ".2f"))))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/roads_tuned.py FOLDER")
    where = Path(sys.argv[1])
    where.mkdir(parents=True, exist_ok=True)
    tune(where)
