"""Searches a scenario for failures of an agent."""

from pathlib import Path
from typing import TYPE_CHECKING

from charms_bench.api.arguments import PathLike, check_positive
from charms_bench.api.warming import warm_up
from charms_bench.errors import InputError, ScenarioError
from charms_bench.foundation.files import absolute, is_same_file
from charms_bench.report.progress import progress
from charms_bench.runs.document import Document
from charms_bench.runs.suite import Cell, check_networks, suite_of

if TYPE_CHECKING:
    from charms_bench.episodes.search import Search


def search(
    suite: PathLike,
    ego: str | None = None,
    traffic: str | None = None,
    output: PathLike = "found.yaml",
    *,
    failures: int = 10,
    budget: int = 5000,
    seed: int = 0,
) -> "Search":
    """Searches a scenario's parameters for failures of an agent, and writes them as a suite.

    A failure is a collision that a driver named by `preventable_by` in the suite avoids. In a
    suite without this key, every collision is a failure.

    Args:
        suite: The YAML file.
        ego: Label of an ego of the suite, or the name of an installed agent; needed if the suite
            has several other egos.
        traffic: Label of the scenario; needed if the suite has several.
        output: The file to write, as soon as there is a failure.
        failures: Number of failures after which the search ends.
        budget: Number of simulated episodes after which the search ends.
        seed: Seed of the search.

    Raises:
        CharmsBenchError: The suite or an agent cannot be used, or a name is unknown.
        KeyboardInterrupt: The search was interrupted; its note names the file.
    """
    from charms_bench.episodes.found_suite import write_found
    from charms_bench.episodes.search import Search, ego_of, scenario_of

    check_positive(failures=failures, budget=budget)
    document, path = Document(Path(suite)), absolute(output)
    if is_same_file(path, document.path):
        raise InputError(f"{output}: is the suite that is searched; choose another --output")
    loaded = suite_of(document)
    check_networks(document, loaded)
    place = scenario_of(document.path, loaded, traffic)
    references = [each for each in loaded.egos if each.title in loaded.preventable_by]
    entry = loaded.traffics[place]
    scene = loaded.scene.of_scenario(entry.traffic.scenario)
    cell = Cell(ego=ego_of(document.path, loaded, ego), traffic=entry, scene=scene)
    made = Search(cell, references, loaded.folder)
    made.found = lambda: write_found(made, document, place, path)
    warm_up()
    try:
        with progress("episodes", budget) as tell:
            made.told = lambda episodes: tell(cell.ego.title, episodes)
            made.run(failures, budget, seed)
    except KeyboardInterrupt as interrupt:
        if made.failures:
            interrupt.add_note(f"{len(made.failures)} failures are in {path}")
        raise
    except ScenarioError as error:
        at = ("traffic_models", place, "traffic", "scenario", *error.location)
        raise document.error(at, str(error)) from error
    if made.failures:
        made.found()
    return made
