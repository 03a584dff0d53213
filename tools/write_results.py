"""Writes the tables of the readme and the documentation.

    python tools/write_results.py suites RUNS
    python tools/write_results.py mutants RUN
    python tools/write_results.py likeness DATA

RUNS holds the run folders of the suites by their names, `RUNS/ego` and so on, and that of the
training as `RUNS/train`. Each gives a file in `docs/results`, which then replaces the text between
`<!-- results: NAME -->` and `<!-- end of results -->` wherever that stands. What RUNS does not
hold stays as it is. The tables of docs/reproduction.md compare `RUNS/released-ego` with `RUNS/ego`,
and so on. CSV files beside them hold the numbers of long tables. `RUNS/rare` is what
`charms-bench rare suites/rare.yaml --output RUNS/rare` made, and `rare_comparison` names others.

The other commands write the tables of docs/mutants.md and docs/likeness.md; `mutants` and
`likeness_page` say of what.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import likeness_page
import mutants
from rare_comparison import rare_comparison, rare_estimate
from result_pages import RESULTS, ROOT, keep, refill
from run_results import (
    avoidability,
    edges,
    fine_tuning,
    made_at,
    reproduction,
    training_time,
)
from suite_results import (
    EDGE_CASES,
    ENVIRONMENT,
    PCH,
    STYLES,
    crossplay,
    ego,
    merge,
    of_suite,
    preventable,
    rates,
    readme,
    realism,
    roads,
    transfer,
)

TABLES: dict[str, tuple[str, Callable[[Path], str]]] = {
    "readme": ("ego", readme),
    "merge": ("merge-mine", merge),
    "runs": ("ego", made_at),
    "ego": ("ego", ego),
    "edge-cases": ("ego", edges),
    "styles": ("styles", partial(of_suite, STYLES)),
    "transfer": ("transfer-traffics", transfer),
    "environment": ("environment", partial(of_suite, ENVIRONMENT)),
    "environment-edge-cases": ("environment", partial(rates, EDGE_CASES)),
    "released-edge-cases": ("released-environment", partial(rates, EDGE_CASES)),
    "realism": ("realism", realism),
    "pch": ("pch", partial(of_suite, PCH)),
    "crossplay": ("crossplay", crossplay),
    "roads": ("roads", roads),
    "preventable": ("r157", preventable),
    "avoidability": ("ego", avoidability),
    "fine-tuning": ("train", fine_tuning),
    "training-time": ("train", training_time),
    "rare": ("rare", rare_estimate),
    "rare-comparison": ("rare", rare_comparison),
    "reproduction-ego": ("released-ego", reproduction),
    "reproduction-styles": ("released-styles", reproduction),
    "reproduction-environment": ("released-environment", reproduction),
}
"""By name: the run folder that is needed, and what makes the text of it."""


def suites(runs: Path) -> None:
    """Writes the tables of `TABLES`."""
    RESULTS.mkdir(exist_ok=True)
    for name, (folder, make) in TABLES.items():
        text = make(runs / folder) if (runs / folder).is_dir() else ""
        if text:
            keep(name, text)
        found = "from" if text else "as it was, nothing in"
        print(f"docs/results/{name}.md: {found} {runs / folder}")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        refill(page)


COMMANDS: dict[str, Callable[..., None]] = {
    "suites": suites,
    "mutants": mutants.write,
    "likeness": likeness_page.write_page,
}

if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in COMMANDS:
        sys.exit(f"usage: python tools/write_results.py {'|'.join(COMMANDS)} FOLDER ...")
    COMMANDS[sys.argv[1]](*map(Path, sys.argv[2:]))
