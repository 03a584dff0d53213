"""Searches a scenario or a road for failures of an agent."""

from typing import TYPE_CHECKING

import numpy as np

from charms_bench.api.arguments import PathLike, asked, check_positive
from charms_bench.api.warming import warm_up
from charms_bench.errors import InputError, ScenarioError
from charms_bench.foundation.progress import progress
from charms_bench.runs.manifest import opened_for_suite
from charms_bench.runs.shard import forget_agents
from charms_bench.runs.suite import Cell

if TYPE_CHECKING:
    from charms_bench.episodes.search import Search


def search(
    suite: PathLike,
    ego: str | None = None,
    traffic: str | None = None,
    output: PathLike | None = None,
    *,
    road: str | None = None,
    agent: str | None = None,
    failures: int = 10,
    budget: int = 5000,
    seed: int = 0,
) -> "Search":
    """Searches the parameters of a scenario or of a road for failures of an agent, or continues.

    A failure is a collision that a driver named by `preventable_by` in the suite avoids. In a
    suite without this key, every collision is a failure. At each point of a road's parameters, all
    episodes of the suite are simulated. The folder keeps what was simulated, so
    that the same call continues an interrupted search, and the failures as the suite `found.yaml`.

    Args:
        suite: The YAML file.
        ego: Label of an ego of the suite, or the name of an installed agent; needed if the suite
            has several other egos.
        traffic: Label of the scenario, or of the traffic model on the road; needed if the suite
            has several.
        output: The folder; by default `runs/NAME-search`, followed by the `agent`.
        road: Label of the road; needed if several have `parameters`, or a scenario is on several.
        agent: Installed agent or path of a network that drives the ego, instead of `ego`.
        failures: Number of failures after which the search ends.
        budget: Number of simulated episodes after which the search ends.
        seed: Seed of the search.

    Raises:
        CharmsBenchError: The suite, an agent or the folder cannot be used, or a name is unknown.
        KeyboardInterrupt: The search was interrupted; its note names the folder.
    """
    from charms_bench.episodes.found_suite import write_found
    from charms_bench.episodes.search import FOUND, MANIFEST, Search, ego_of, surroundings_of

    check_positive(failures=failures, budget=budget)
    if agent is not None and ego is not None:
        raise InputError("give either an ego of the suite or an agent")
    agents = [] if agent is None else [agent]
    document, loaded, _, folder = asked(suite, output, agents, "-search")
    ego = loaded.egos[-1].title if agents else ego
    where, entry = surroundings_of(document.path, loaded, road, traffic)
    index = loaded.traffics.index(entry)
    references = [each for each in loaded.egos if each.title in loaded.preventable_by]
    scene = loaded.scene if where else loaded.scene.of_scenario(entry.traffic.scenario)
    cell = Cell(ego=ego_of(document.path, loaded, ego), road=where, traffic=entry, scene=scene)
    seeds = loaded.seed + np.arange(loaded.episodes)
    made = Search(cell, references, loaded.folder, folder, seeds)
    made.found = lambda: write_found(made, document, loaded, folder / FOUND)
    warm_up()
    sought: dict[str, object] = {"ego": cell.ego.title, "traffic": entry.title, "seed": seed}
    if where is not None:
        sought |= {"road": where.title, "episodes": loaded.episodes}
    sought["preventable_by"] = [each.title for each in references]
    forget_agents()
    try:
        with (
            opened_for_suite(folder, MANIFEST, "search", loaded, {"search": sought}),
            progress("episodes", budget) as tell,
        ):
            made.told = lambda episodes: tell(cell.ego.title, episodes)
            made.run(failures, budget, seed)
            if made.failures:
                made.found()
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(f"{len(made.failures)} failures are in {folder}")
        raise
    except ScenarioError as error:
        at = ("traffic_models", index, "traffic", "scenario", *error.location)
        raise document.error(at, str(error)) from error
    return made
