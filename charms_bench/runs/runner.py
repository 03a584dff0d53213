"""Runs a suite: splits cells into shards, has workers simulate them, and keeps their rows."""

import os
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TypeVar

from charms_bench.errors import CharmsBenchError, RunFolderError, SuiteError
from charms_bench.foundation.progress import Tell
from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.foundation.words import counted
from charms_bench.foundation.workers import Failed, in_processes
from charms_bench.plugins.registry import is_network
from charms_bench.plugins.specs import AgentSpec, drivers_of, networks_of
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import FinishedRun
from charms_bench.runs.resumable_folder import NETWORKS, ROADS, RunFolder
from charms_bench.runs.shard import (
    CellTask,
    ShardFiles,
    ShardTask,
    agent_of,
    forget_agents,
    installed,
    simulate,
    traffic_of,
)
from charms_bench.runs.shard_names import Shard, blocks, places_of, shard_named
from charms_bench.runs.suite import Cell, Suite
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import EVALUATION_SEEDS

T = TypeVar("T", bound=CellTask)
R = TypeVar("R")
LISTED = 10
"""Most errors of other cells that a message lists."""
SHARD_LIMIT_S = 1800.0
"""Far longer than a shard takes if its agents answer."""

Notice = Callable[[str], None]
"""Called with a message about something that went wrong and was put right."""
SimulateAll = Callable[
    [Sequence[ShardTask], float, Notice], Generator[tuple[ShardTask, ShardFiles], None, None]
]
"""Simulates shards somewhere: yields each task with its files as soon as it is finished.

Its arguments are the tasks, the seconds that a shard may take, and where notices go. Closing the
generator ends the shards that are not finished.
"""


def run(
    suite: Suite,
    output: Path,
    workers: int | None = None,
    tell: Tell = lambda ego, episodes: None,
    rows: Path | None = None,
    shard_limit_s: float = SHARD_LIMIT_S,
    notice: Notice = lambda what: None,
    cluster: SimulateAll | None = None,
    on_cell: Callable[[int, CellRows], None] = lambda index, rows: None,
    shorten: bool = False,
) -> FinishedRun:
    """Runs a suite in the folder `output`; finished shards in it are not simulated again.

    A cell whose agents or traffic model fail does not end the run: it is one of `failed`. On a
    cluster it does, because a failed plugin may have changed the process, which is not ours to end.

    An interrupted run in the folder is continued. Other arguments are those of `charms_bench.run`.

    Args:
        tell: Called for every finished shard with its ego and its number of episodes, first for
            those already in the folder.
        cluster: Simulates the shards elsewhere than on this machine; see `cluster.on_cluster`.
        on_cell: Called for every cell that is finished, with its index and its rows.

    Raises a `CharmsBenchError` if something is wrong; the folder keeps the shards finished so far.
    """
    folder, failed = RunFolder(output), dict[int, CharmsBenchError]()
    with folder.opened_for(suite):
        tasks = plan(suite, failed)
        for what in _reasons(suite, failed):
            notice(f"{what}; the other cells are run")
        agents = {
            name: identity
            for task in tasks.values()
            for name, identity in task.software.agents.items()
        }
        if not shorten:
            folder.reject_to_drop(suite, tasks)
        before = dict(blocks(suite.model_copy(update={"episodes": folder.episodes()})))
        folder.write_manifest(suite, agents)
        networks = {k: path for task in tasks.values() for k, path in task.networks.items()}
        for name, path in networks.items():
            folder.keep(NETWORKS, path, agents[name]["weights_sha256"])
        for road in suite.roads:
            if road.file is not None:
                folder.keep(ROADS, road.file, str(road.sha256))
        if rows is not None:
            folder.take(tasks, rows, notice)
        run = FinishedRun(suite, folder, tuple(tasks), failed)
        for index in range(len(suite.surroundings)):
            run.left_out(index)  # rejects scenarios of which none counts
        unfinished = Counter(shard.cell for shard in tasks)

        def finish(shard: Shard) -> None:
            tell(suite.cells[shard.cell].ego.title, shard.episodes)
            unfinished[shard.cell] -= 1
            if not unfinished[shard.cell]:
                on_cell(shard.cell, run.cell(shard.cell))

        missing: dict[ShardTask, Shard] = {}
        for shard, task in tasks.items():
            if folder.is_whole(shard):
                finish(shard)
            else:
                missing[task] = shard
                if folder.has(shard):
                    notice(f"{task.title}: changed since they were written; simulated again")

        _note_replaced(suite, before, folder.finished(), missing.values(), notice)
        fail = note_failures(suite, failed, notice, missing)
        here = partial(on_this_machine, simulate, workers, failed=fail)
        simulate_all: SimulateAll = cluster or here
        try:
            with closing(simulate_all(list(missing), shard_limit_s, notice)) as finished:
                for task, files in finished:
                    folder.write(missing[task], files)
                    finish(missing[task])
            if len(failed) == len(suite.cells):
                raise combined(suite, failed)
        except CharmsBenchError as error:
            if folder.finished():
                error.add_note(f"finished shards are in {output}; the same command continues there")
            raise
        # A cell that could not be planned keeps its rows; another that failed has none of before.
        places, planned = places_of(suite), {shard.cell for shard in tasks}
        named = (shard_named(name, places) for name in folder.finished())
        unplanned = [shard for shard in named if shard and shard.cell not in planned]
        folder.drop_others([*tasks, *unplanned])
    return run


def _note_replaced(
    suite: Suite,
    before: Mapping[int, int],
    finished: Iterable[str],
    missing: Collection[Shard],
    notice: Notice,
) -> None:
    """Says which egos' finished shards, by their names, have other keys now.

    `before` has the numbers of episodes of the shards that the folder was made for, by first seed.
    If a shard has more or fewer episodes now, that is why its key differs.
    """
    names = {shard.name for shard in missing}
    places = {
        shard.name.rpartition("-")[0]: shard
        for shard in missing
        if before.get(shard.first_seed) == shard.episodes
    }
    replaced = Counter(
        suite.cells[places[place].cell].ego.title
        for name in finished
        if name not in names and (place := name.rpartition("-")[0]) in places
    )
    for ego, count in replaced.items():
        notice(
            f"{ego}: {counted(count, 'finished shard')} replaced, because the agent, the traffic "
            "model or the software has changed"
        )


def plan(suite: Suite, failed: dict[int, CharmsBenchError] | None = None) -> dict[Shard, ShardTask]:
    """Returns the shards of a suite, by cell and seed, each with the task that simulates it.

    The errors of cells that their agents cannot drive are added to `failed`, by cell. If these are
    all, an agent cannot be made, or a seed is one of training episodes, an error is raised.
    """
    if suite.seed + suite.episodes > EVALUATION_SEEDS:
        raise SuiteError(
            f"suite '{suite.suite}': seeds {suite.seed} to {suite.seed + suite.episodes - 1}; "
            f"expected seeds below {EVALUATION_SEEDS}, where the seeds of trainings start"
        )
    forget_agents()
    tasks: dict[Shard, ShardTask] = {}
    failed = {} if failed is None else failed
    for index in range(len(suite.cells)):
        try:
            tasks |= plan_cell(suite, index)
        except SuiteError as error:
            failed[index] = error
    if not tasks:
        raise combined(suite, failed)
    return tasks


def note_failures(
    suite: Suite, failed: dict[int, CharmsBenchError], notice: Notice, tasks: Collection[T]
) -> Failed[T]:
    """A function that adds the first error of a cell to `failed` and drops the cell's other tasks.

    It raises an error that is no agent's fault.
    """

    def fail(task: T, error: CharmsBenchError) -> Collection[T]:
        if isinstance(error, RunFolderError):
            raise error
        if task.cell not in failed:
            failed[task.cell] = error
            if len(suite.cells) > 1:
                if (title := suite.cells[task.cell].title) not in str(error):
                    error.args = (f"{title}: {error}",)
                notice(f"{error}; the other cells are run")
        return {each for each in tasks if each.cell == task.cell}

    return fail


def combined(suite: Suite, failed: Mapping[int, CharmsBenchError]) -> CharmsBenchError:
    """Returns the first of the errors of cells, with notes on the others."""
    first = next(iter(failed.values()))
    what, *others = _reasons(suite, failed)
    first.args = (what,)
    for other in others[:LISTED]:
        first.add_note(other)
    if len(others) > LISTED:
        first.add_note(f"and {len(others) - LISTED} more errors")
    return first


def raise_failed(suite: Suite, failed: Mapping[int, CharmsBenchError], folder: Path) -> None:
    """Raises the errors of the cells that have failed, if some have, after the others' tables."""
    if failed:
        error, cells = combined(suite, failed), len(suite.cells)
        error.add_note(
            f"{cells - len(failed)} of {counted(cells, 'cell')} are finished; `charms-bench show "
            f"{quote(str(folder))}` prints their tables, and the same command continues there"
        )
        raise error


def _reasons(suite: Suite, failed: Mapping[int, CharmsBenchError]) -> list[str]:
    """Each error once, also if it differs only by the name of the road, with its other cells."""
    alike: dict[str, list[int]] = {}
    for index, error in failed.items():
        road = f"the road '{suite.cells[index].scene.network}'"
        alike.setdefault(str(error).replace(road, ""), []).append(index)
    found = []
    for first, *others in alike.values():
        titles = [suite.cells[index].title for index in others[:LISTED]]
        titles += [f"{len(others) - LISTED} more cells"] * (len(others) > LISTED)
        found.append(f"{failed[first]}" + f" (also {', '.join(titles)})" * bool(others))
    return found


def plan_cell(suite: Suite, index: int, folder: RunFolder | None = None) -> dict[Shard, ShardTask]:
    """Returns the shards of one cell; see `plan`.

    If a run folder is given, its copies of networks are used instead of the suite's files.
    """
    cell = suite.cells[index]
    ego, traffic = cell.ego.agent, cell.traffic.traffic
    networks = networks_of(ego, traffic_of(traffic), suite.folder)
    if folder is not None:
        networks = {name: folder.network(name) or path for name, path in networks.items()}
    software = installed(ego, traffic, networks, cell.road is not None)
    for each in drivers_of(ego, traffic_of(traffic)) if not cell.scene.is_recorded else ():
        if getattr(agent_of(each, networks), "follows_recording", False):
            raise SuiteError(
                f"suite '{suite.suite}': {cell.title}: agent '{each.key}' drives as recorded; "
                "give the suite recordings with scene.recording, or the road a recorded scene with "
                "configuration.start"
            )
    if cell.scene.network is not None:
        _check_road(suite, cell, networks)
    driver = ego.key
    if is_network(ego.name):
        driver = f"{software.agents[ego.name]['weights_sha256']}.onnx"
    tasks = {}
    for first, episodes in blocks(suite):
        task = ShardTask(
            title=f"{cell.title}, episodes {first} to {first + episodes - 1}",
            cell=index,
            scene=cell.scene,
            ego=ego,
            traffic=traffic,
            networks=networks,
            first_seed=first,
            episodes=episodes,
            software=software,
        )
        tasks[Shard(index, first, episodes, task.key, driver)] = task
    return tasks


def _check_road(suite: Suite, cell: Cell, networks: Mapping[str, Path]) -> None:
    """Raises a `SuiteError` if a cell's agents cannot drive on its road."""
    from charms_bench.roads.settings import problem_of_driver

    others = traffic_of(cell.traffic.traffic).agents
    seats = [cell.ego.agent, *(AgentSpec(name=name) for name in others if name != PRESCRIBED)]
    for k, driver in enumerate(seats):
        if what := problem_of_driver(agent_of(driver, networks), is_ego=k == 0):
            raise SuiteError(
                f"suite '{suite.suite}': agent '{driver.key}' cannot drive on the road "
                f"'{cell.scene.network}': {what}"
            )


def on_this_machine(
    work: Callable[[T], R],
    workers: int | None,
    tasks: Collection[T],
    limit_s: float,
    notice: Notice,
    failed: Failed[T] | None = None,
) -> Generator[tuple[T, R], None, None]:
    """Does the work of tasks in processes on this machine; see `SimulateAll`."""
    count = min(workers or os.cpu_count() or 1, len(tasks))

    def title(task: CellTask) -> str:
        """What messages call a task whose worker has died, perhaps because of a network."""
        return f"{task.title} ({', '.join(task.networks)})" if task.networks else task.title

    return in_processes(work, tasks, count, title, limit_s, notice, ONE_THREAD, failed)
