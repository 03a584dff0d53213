"""Writes the tables of the readme and the documentation.

    python tools/write_results.py suites RUNS
    python tools/write_results.py mutants RUN
    python tools/write_results.py likeness DATA
    python tools/write_results.py plan-roads NETWORKS RUNS
    python tools/write_results.py roads-ablations FOLDER
    python tools/write_results.py rare-coverage

RUNS holds the run folders of the suites by their names, `RUNS/ego` and so on, and that of the
training as `RUNS/train`. Each gives tables, which replace the text between `<!-- results: NAME -->`
and `<!-- end of results -->` wherever that stands. What RUNS does not hold stays as it is. The
tables of docs/reproduction.md compare `RUNS/released-ego` with `RUNS/ego`, and so on. CSV files in
`docs/results` hold the numbers of long tables. `RUNS/rare` is what
`charms-bench rare suites/rare.yaml --output RUNS/rare` made, and `rare_comparison` names others.

The other commands write tables of other pages; the modules that they are from say of what.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import likeness_page
import mutants
import plan_roads_tables
import rare_coverage
import roads_ablations
import run_results as of_runs
import suite_results as of_suites
from rare_comparison import rare_comparison, rare_estimate
from result_pages import keep
from transfer import transfer

TABLES: dict[str, tuple[str, Callable[[Path], str]]] = {
    "readme": ("ego", of_suites.readme),
    "merge": ("merge-mine", of_suites.merge),
    "runs": ("ego", of_runs.made_at),
    "ego": ("ego", of_suites.ego),
    "edge-cases": ("ego", of_runs.edges),
    "styles": ("styles", partial(of_suites.of_suite, of_suites.STYLES)),
    "transfer": ("transfer-traffics", transfer),
    "environment": ("environment", partial(of_suites.of_suite, of_suites.ENVIRONMENT)),
    "environment-edge-cases": ("environment", partial(of_suites.rates, of_suites.EDGE_CASES)),
    "released-edge-cases": ("released-environment", partial(of_suites.rates, of_suites.EDGE_CASES)),
    "realism": ("realism", of_suites.realism),
    "pch": ("pch", partial(of_suites.of_suite, of_suites.PCH)),
    "crossplay": ("crossplay", of_suites.crossplay),
    "roads": ("roads", of_suites.roads),
    "preventable": ("r157", of_suites.preventable),
    "avoidability": ("ego", of_runs.avoidability),
    "fine-tuning": ("train", of_runs.fine_tuning),
    "training-time": ("train", of_runs.training_time),
    "rare": ("rare", rare_estimate),
    "rare-comparison": ("rare", rare_comparison),
    "reproduction-ego": ("released-ego", of_runs.reproduction),
    "reproduction-styles": ("released-styles", of_runs.reproduction),
    "reproduction-environment": ("released-environment", of_runs.reproduction),
}
"""By name: the run folder that is needed, and what makes the text of it."""


def suites(runs: Path) -> None:
    """Writes the tables of `TABLES`."""
    for name, (folder, make) in TABLES.items():
        text = make(runs / folder) if (runs / folder).is_dir() else ""
        if text:
            keep(name, text)
        found = "from" if text else "as it was, nothing in"
        print(f"{name}: {found} {runs / folder}")


COMMANDS: dict[str, Callable[..., None]] = {
    "suites": suites,
    "mutants": mutants.write,
    "likeness": likeness_page.write_page,
    "plan-roads": plan_roads_tables.tables,
    "roads-ablations": roads_ablations.tables,
    "rare-coverage": rare_coverage.write,
}

if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
        sys.exit(f"usage: python tools/write_results.py {'|'.join(COMMANDS)} FOLDER ...")
    COMMANDS[sys.argv[1]](*map(Path, sys.argv[2:]))
