"""How often the intervals of `charms-bench rare` hold a probability that is known.

    python tools/rare_coverage.py [PROBLEM ...]

Each of 2,000 repetitions is an estimate as the command makes it: 10 independent runs with 1,000
samples per level. It takes about an hour on one core, and prints the table of
docs/rare-events.md.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "statistics"))

from known_probabilities import DIMENSION, PROBLEMS

from charms_bench.statistics.intervals import wilson
from charms_bench.statistics.subset_simulation import interval, subset_simulation

REPETITIONS = 2000
RUNS, SAMPLES = 10, 1000


def main() -> None:
    """Prints one line per problem and probability."""
    print("| problem | probability | holds it | below | above | mean / probability | episodes |")
    print("|---|---:|---:|---:|---:|---:|---:|", flush=True)
    for name in sys.argv[1:] or PROBLEMS:
        for probability in (1e-3, 1e-5, 1e-7):
            print(line(name, probability), flush=True)


def line(name: str, probability: float) -> str:
    """Returns the line of a problem."""
    level, means, evaluations = PROBLEMS[name](probability), [], 0
    bounds = np.empty((REPETITIONS, 2))
    for repetition in range(REPETITIONS):
        rng = np.random.default_rng([repetition, round(-np.log10(probability))])
        runs = subset_simulation(level, DIMENSION, SAMPLES, RUNS, rng)
        bounds[repetition] = interval(runs, SAMPLES)
        means.append(np.mean([run.probability for run in runs]) / probability)
        evaluations += sum(run.evaluations for run in runs)
    below, above = bounds[:, 1] < probability, bounds[:, 0] > probability
    holds = REPETITIONS - below.sum() - above.sum()
    low, high = wilson(holds, REPETITIONS)
    cells = (
        name.replace("_", " "),
        f"{probability:.0e}",
        f"{holds / REPETITIONS:.1%} [{low:.1%}, {high:.1%}]",
        f"{below.mean():.1%}",
        f"{above.mean():.1%}",
        f"{np.mean(means):.3f}",
        f"{evaluations / REPETITIONS:,.0f}",
    )
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
