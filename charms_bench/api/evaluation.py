"""Runs a suite."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

from charms_bench.api.arguments import PathLike, asked, check_positive, ego_entry, evaluation_in
from charms_bench.api.results import Run
from charms_bench.api.warming import note_roads, warm_up
from charms_bench.engine import ENGINES, EngineName
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.files import absolute
from charms_bench.people.reference import read_references
from charms_bench.plugins.specs import drivers_of, networks_of
from charms_bench.report.progress import note, progress
from charms_bench.runs import runner
from charms_bench.runs.cells import CellRows
from charms_bench.runs.lock import locked
from charms_bench.runs.resumable_folder import RunFolder
from charms_bench.runs.runner import SHARD_LIMIT_S
from charms_bench.runs.suite import Suite, suite_of

if TYPE_CHECKING:
    from charms_bench.engine.simulation import Simulation
    from charms_bench.report.run_files import MeasuredCell


def run(
    suite: PathLike,
    output: PathLike | None = None,
    *,
    agents: Sequence[str] = (),
    episodes: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    engine: EngineName = "batched",
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
        engine: `batched`, or `highway-env`, the slow reference.
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
    if engine not in ENGINES:
        raise InputError(
            f"no engine named '{engine}'. {suggestion(engine, dict.fromkeys(ENGINES))}"
        )
    check_positive(workers=workers, shard_limit_s=shard_limit_s)
    if cluster is not None and engine != "batched":
        raise InputError("a cluster runs the engine 'batched'; 'highway-env' runs on this machine")
    if cluster is not None and workers is not None:
        raise InputError("workers are processes on this machine; a cluster has its own")
    taken = None if rows is None else absolute(rows)
    _, loaded, _, folder = asked(suite, output, agents, episodes=episodes, seed=seed)
    references = read_references(loaded.references, loaded.folder)
    if engine == "batched" and cluster is None:
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
            finished = runner.run(
                loaded,
                folder,
                engine,
                workers,
                lambda cell, count: tell(cell.ego.title, count),
                taken,
                shard_limit_s or SHARD_LIMIT_S,
                notice,
                on_dask,
                measure_cell,
                shorten,
            )
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


def cell_of(suite: PathLike, agent: str, traffic: str | None) -> "tuple[Simulation, str, int]":
    """One scene of a suite with an agent as the ego, its title, and the suite's first seed.

    `traffic` is the label of one of the suite's traffic models; None is the only one.

    Raises:
        CharmsBenchError: The suite, the agent or the label cannot be used.
    """
    from charms_bench.engine.simulation import Simulation

    document = evaluation_in(suite)
    document.data["egos"] = [ego_entry(agent)]
    for name in ("preventable_by", "pairs", "references"):  # of the egos of the suite
        document.data.pop(name, None)
    loaded = suite_of(document)
    found = {cell.traffic.title: cell for cell in loaded.cells}
    if traffic is None and len(found) > 1:
        what = f"{len(found)} traffic models; choose one with --traffic"
        raise InputError(f"{suite}: {what}. {suggestion('', found)}")
    if traffic is not None and traffic not in found:
        raise InputError(f"{suite}: no traffic model '{traffic}'. {suggestion(traffic, found)}")
    cell = found[traffic] if traffic is not None else next(iter(found.values()))
    if cell.scene.network is not None:
        raise InputError(
            f"{suite}: an episode is watched on the straight road, not the road "
            f"'{cell.scene.network}'; `charms-bench replay` draws the episodes of a run there"
        )
    ego, around = cell.ego.agent, cell.traffic.traffic.make()
    networks = networks_of(ego, around, loaded.folder)
    agents = {each.key: each.make(networks) for each in drivers_of(ego, around)}
    return Simulation(cell.scene, 1, ego.key, around, agents), cell.title, loaded.seed


def _measure(suite: Suite, rows: CellRows) -> "MeasuredCell":
    from charms_bench.report.run_files import measure  # takes a while, so not before the workers

    return measure(suite, rows)
