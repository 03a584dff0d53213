"""How often the intervals of `charms-bench rare` hold a probability that is known.

`write_results.py rare-coverage` writes it to its page, which takes about half
an hour on one core. Each repetition is a pilot and 500 independent runs; the intervals of fewer
runs are those of the first of them. The moves treat all directions alike and the events depend on
at most two components, so two components stand for any number of them.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "statistics"))

from known_probabilities import PROBLEMS
from result_pages import keep

from charms_bench.statistics.subset_simulation import interval, pilot_run, subset_simulation

REPETITIONS = {100: 1000, 400: 400}
"""By the samples per level."""
RUNS = (5, 10, 50, 100, 500)
EVENTS = (
    *(("linear", probability) for probability in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)),
    *((name, 1e-4) for name in ("two_sided", "stepped", "jump")),
)


def write() -> None:
    """Writes one row per event, probability and number of samples."""
    counts = " | ".join(f"{count} runs" for count in RUNS)
    lines = [f"| event | probability | samples | mean / probability | {counts} |"]
    lines.append("|---|---:|---:|---:|" + "---:|" * len(RUNS))
    for name, probability in EVENTS:
        for samples in REPETITIONS:
            lines.append(line(name, probability, samples))
            print(lines[-1], flush=True)
    keep("rare-coverage", "\n".join(lines) + "\n")


def line(name: str, probability: float, samples: int) -> str:
    """Returns the row of an event."""
    level, means = PROBLEMS[name](probability), []
    covering, repetitions = np.zeros(len(RUNS)), REPETITIONS[samples]
    for repetition in range(repetitions):
        rng = np.random.default_rng([repetition, round(-np.log10(probability)), samples])
        pilot = pilot_run(level, 2, samples, rng)
        runs = subset_simulation(level, 2, samples, max(RUNS), pilot, rng)
        means.append(np.mean([run.probability for run in runs]) / probability)
        for place, count in enumerate(RUNS):
            low, high = interval(runs[:count], samples)
            covering[place] += low <= probability <= high
    error = np.std(means, ddof=1) / repetitions**0.5
    cells = (
        name.replace("_", "-"),
        f"{probability:.0e}",
        f"{samples}",
        f"{np.mean(means):.3f} ± {error:.3f}",
        *(f"{each / repetitions:.1%}".replace("%", " %") for each in covering),
    )
    return f"| {' | '.join(cells)} |"
