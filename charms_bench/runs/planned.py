"""The cells of a finished run, planned again with the installed software."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from charms_bench.errors import CharmsBenchError
from charms_bench.runs.folder import RunFolder
from charms_bench.runs.runner import plan_cell
from charms_bench.runs.shard import ShardTask, forget_agents
from charms_bench.runs.shards import Shard
from charms_bench.runs.suite import Cell, Suite


@dataclass(frozen=True)
class Planned:
    """A cell, as the installed software runs it."""

    cell: Cell
    tasks: Mapping[str, tuple[Shard, ShardTask]]
    """Its shards and how to simulate them, by name; empty if it cannot be run."""
    agents: Mapping[str, Mapping[str, str]]
    """See `shard.identify_agents`."""
    problem: str
    """Why it cannot be run; empty if it can."""
    own: frozenset[str]
    """The shards in the folder with the keys of the installed software.

    A key is a hash of the code, the libraries, the agents and the settings that decide rows. So
    these shards were made with the installed software, or are claimed to be.
    """


def planned_again(folder: RunFolder, suite: Suite, names: Collection[str]) -> list[Planned]:
    """Plans every cell of a suite; `names` are those of the shards in its run folder.

    Raises:
        RunFolderError: The manifest names no engine.
    """
    forget_agents()
    engine, found = folder.engine(), []
    for index, cell in enumerate(suite.cells):
        try:
            planned = plan_cell(suite, index, engine, folder)
        except CharmsBenchError as error:
            found.append(Planned(cell, {}, {}, str(error), frozenset()))
            continue
        tasks = {shard.name: (shard, task) for shard, task in planned.items()}
        agents = next(iter(planned.values())).software.agents
        found.append(Planned(cell, tasks, agents, "", frozenset(tasks.keys() & set(names))))
    return found
