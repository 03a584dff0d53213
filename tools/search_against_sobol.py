"""How many episodes a search and Sobol points need to find a preventable collision.

    python tools/search_against_sobol.py suites/r157.yaml Cut-in idm_mobil --repetitions 20

The episodes up to the first failure are counted, with the seeds 0 to `repetitions` - 1. Those of
the search include the episodes of the reference drivers, and those of Sobol points do not.
"""

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

from charms_bench.episodes.search import Search, ego_of, scenario_of
from charms_bench.runs.suite import Cell, load_suite
from charms_bench.world.parameter_points import sobol

AT_ONCE = 256
RATE_POINTS = 4096
"""Sobol points from which the failure rate is estimated."""


def main() -> None:
    """Prints the episodes of every repetition."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("suite", type=Path)
    parser.add_argument("scenario")
    parser.add_argument("agent")
    parser.add_argument("--repetitions", type=int, default=20)
    parser.add_argument("--budget", type=int, default=10_000)
    options = parser.parse_args()

    suite = load_suite(options.suite)
    entry = scenario_of(options.suite, suite, options.scenario)
    cell = Cell(
        ego=ego_of(options.suite, suite, options.agent),
        traffic=entry,
        scene=suite.scene.of_scenario(entry.traffic.scenario),
    )
    references = [each for each in suite.egos if each.title in suite.preventable_by]
    assert entry.traffic.scenario is not None
    dimensions = len(entry.traffic.scenario.parameters)

    def started() -> Search:
        return Search(cell, references, suite.folder)

    whole = started()
    for first in range(0, RATE_POINTS, AT_ONCE):
        whole.values(sobol(dimensions, first, AT_ONCE))
    failures = len(whole.failures)
    print(f"failures: {failures} of {RATE_POINTS} Sobol points ({failures / RATE_POINTS:.2%})")
    for names, count in Counter(map(" and ".join, whole.preventable_by)).items():
        print(f"preventable by {names}: {count}")

    needed: dict[str, list[int]] = {"search": [], "sobol": []}
    for seed in range(options.repetitions):
        search, points = started(), started()
        search.run(1, options.budget, seed)
        needed["search"].append(search.simulations_to_first or options.budget)
        asked = options.budget
        for first in range(0, options.budget, AT_ONCE):
            is_failure = points.values(sobol(dimensions, first, AT_ONCE, scramble=seed)) < 0
            if is_failure.any():
                asked = first + int(is_failure.argmax()) + 1
                break
        needed["sobol"].append(asked)
        print(f"seed {seed}: {needed['search'][-1]} and {asked} episodes", flush=True)
    for name, episodes in needed.items():
        quartiles = np.quantile(episodes, [0.25, 0.5, 0.75])
        print(f"{name}: mean {np.mean(episodes):.0f}, quartiles {quartiles}, {sorted(episodes)}")
    fewer = sum(a < b for a, b in zip(*needed.values(), strict=True))
    print(f"fewer episodes with the search in {fewer} of {options.repetitions} repetitions")


if __name__ == "__main__":
    main()
