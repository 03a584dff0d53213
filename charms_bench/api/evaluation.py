"""Runs a suite."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeVar

from charms_bench.api.arguments import PathLike, asked, check_positive, ego_entry, evaluation_in
from charms_bench.api.results import Run
from charms_bench.api.warming import note_roads, warm_up
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.files import absolute
from charms_bench.foundation.progress import note, progress
from charms_bench.humans.reference import read_references
from charms_bench.plugins.specs import agents_of
from charms_bench.runs import runner
from charms_bench.runs.cells import CellRows
from charms_bench.runs.lock import locked
from charms_bench.runs.resumable_folder import RunFolder
from charms_bench.runs.runner import SHARD_LIMIT_S
from charms_bench.runs.shard import engine_on
from charms_bench.runs.suite import Suite, Surroundings, TrafficEntry, suite_of
from charms_bench.runs.suite_roads import RoadEntry

if TYPE_CHECKING:
    from charms_bench.engine.simulation import Simulation
    from charms_bench.report.run_files import MeasuredCell

Entry = TypeVar("Entry", RoadEntry, TrafficEntry)


def run(
    suite: PathLike,
    output: PathLike | None = None,
    *,
    agents: Sequence[str] = (),
    episodes: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    rows: PathLike | None = None,
    cluster: str | None = None,
    shard_limit_s: float | None = None,
    shorten: bool = False,
    notice: Callable[[str], None] = note,
) -> Run:
    """Runs a suite, or continues an interrupted run of it; finished shards are not simulated again.

    Args:
        suite: The YAML file.
        output: The run folder; by default `runs/NAME`, followed by the `agents`.
        agents: Installed agents or paths of networks that drive the ego besides the suite's egos.
        episodes: Episodes per cell, instead of the suite's.
        seed: Seed of the first episode, instead of the suite's.
        workers: Processes; by default one per core.
        rows: Another run's folder; episodes that it already has are copied.
        cluster: Address of a Dask scheduler, such as `tcp://HOST:8786`.
        shard_limit_s: Time limit for one shard, including the start of its worker; by default half
            an hour.
        shorten: Whether a run of fewer episodes may delete the others from its folder.
        notice: Called with messages about problems that were solved, such as a worker that died.

    Raises:
        CharmsBenchError: The suite, an agent or the folder cannot be used; finished shards stay. If
            an agent or a traffic model fails in some cells, the tables hold the others.
        KeyboardInterrupt: The run was interrupted; its note names the folder.
    """
    check_positive(workers=workers, shard_limit_s=shard_limit_s)
    if cluster is not None and workers is not None:
        raise InputError("workers are processes on this machine; a cluster has its own")
    taken = None if rows is None else absolute(rows)
    _, loaded, _, folder = asked(suite, output, agents, episodes=episodes, seed=seed)
    references = read_references(loaded.references, loaded.folder)
    if cluster is None:
        warm_up()
        note_roads(loaded)
    on_dask = None
    if cluster is not None:
        from charms_bench.runs.cluster import on_cluster

        on_dask = on_cluster(cluster)
    measuring = ThreadPoolExecutor(1)  # more threads would need more memory
    cells: dict[int, Future[MeasuredCell]] = {}

    def measure_cell(index: int, rows: CellRows) -> None:
        cells[index] = measuring.submit(_measure, loaded, rows)

    try:
        with progress("episodes", loaded.episodes * len(loaded.cells)) as tell:
            given = taken, shard_limit_s or SHARD_LIMIT_S, notice, on_dask, measure_cell, shorten
            finished = runner.run(loaded, folder, workers, tell, *given)
        from charms_bench.report.run_files import write_run

        with locked(folder):
            following = finished.following() if references else []
            measured = [cells[index].result() for index in sorted(cells)]
            write_run(loaded, folder, measured, following, references)
        runner.raise_failed(loaded, finished.failed, folder)
    except KeyboardInterrupt as interrupt:
        if RunFolder(folder).finished():
            interrupt.add_note(f"finished shards are in {folder}")
        raise
    finally:
        measuring.shutdown(cancel_futures=True)  # whose files may be deleted after this
    return Run(finished, loaded.folder)


def cell_of(
    suite: PathLike, agent: str, traffic: str | None, road: str | None = None
) -> "tuple[Simulation, str, int]":
    """One scene of a suite with an agent as the ego, its title, and the suite's first seed.

    `traffic` and `road` are the labels of one of the suite's traffic models and of one of its
    roads; None is the only one. A `CharmsBenchError` says what cannot be used.
    """
    from charms_bench.engine.simulation import Simulation

    document = evaluation_in(suite)
    document.data["egos"] = [ego_entry(agent)]
    for name in ("preventable_by", "pairs", "references"):  # of the egos of the suite
        document.data.pop(name, None)
    loaded = suite_of(document)
    if road is not None and not loaded.roads:
        raise InputError(f"{suite}: has no `roads`; remove --road")
    chosen = _one_of(suite, "traffic model", "--traffic", loaded.traffics, traffic)
    on = _one_of(suite, "road", "--road", loaded.roads, road) if loaded.roads else None
    around_ego = Surroundings(on, chosen)
    cell = next(each for each in loaded.cells if each.surroundings == around_ego)
    ego, around = cell.ego.agent, cell.traffic.traffic.make()
    agents = agents_of(ego, around, loaded.folder)
    engine = engine_on(cell.scene)
    return Simulation(cell.scene, 1, ego.key, around, agents, engine), cell.title, loaded.seed


def _one_of(
    suite: PathLike, what: str, option: str, entries: Sequence[Entry], title: str | None
) -> Entry:
    """The entry of a suite with a title, or its only one."""
    found = {each.title: each for each in entries}
    if title is None and len(found) > 1:
        choose = f"{len(found)} {what}s; choose one with {option}"
        raise InputError(f"{suite}: {choose}. {suggestion('', found)}")
    if title is not None and title not in found:
        raise InputError(f"{suite}: no {what} '{title}'. {suggestion(title, found)}")
    return found[title] if title is not None else entries[0]


def _measure(suite: Suite, rows: CellRows) -> "MeasuredCell":
    from charms_bench.report.run_files import measure  # takes a while, so not before the workers

    return measure(suite, rows)
