"""Runs a suite."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from charms_bench.api.arguments import PathLike, check_positive
from charms_bench.api.results import Run
from charms_bench.api.warming import warm_up
from charms_bench.engine import ENGINES, EngineName
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.files import absolute
from charms_bench.foundation.names import name_of_agent
from charms_bench.people.reference import read_references
from charms_bench.plugins.registry import AGENTS, find
from charms_bench.report.progress import note, progress
from charms_bench.runs import runner
from charms_bench.runs.cells import CellRows
from charms_bench.runs.document import Document
from charms_bench.runs.lock import locked
from charms_bench.runs.resumable_folder import RunFolder
from charms_bench.runs.runner import SHARD_LIMIT_S
from charms_bench.runs.suite import Suite, check_networks, suite_of

if TYPE_CHECKING:
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
        CharmsBenchError: The suite, an agent or the folder cannot be used; finished shards stay.
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
    document = Document(Path(suite))
    if "pipeline" in document.data:
        raise InputError(f"{suite}: is a training suite; use charms_bench.train")
    changes = {"episodes": episodes, "seed": seed}
    document.data |= {name: value for name, value in changes.items() if value is not None}
    added = [_ego(agent) for agent in agents]
    if added and isinstance(document.data.get("egos"), list):
        document.data["egos"] = document.data["egos"] + added
    # Before plugins are imported, which can change the current folder.
    place, taken = absolute(output or "runs"), None if rows is None else absolute(rows)
    loaded = suite_of(document)
    check_networks(document, loaded)
    references = read_references(loaded.references, loaded.folder)
    name = "-".join((loaded.suite, *(name_of_agent(ego["label"]) for ego in added)))
    folder = place if output else place / name
    if engine == "batched" and cluster is None:
        warm_up()
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
    except KeyboardInterrupt as interrupt:
        if RunFolder(folder).finished():
            interrupt.add_note(f"finished shards are in {folder}")
        raise
    finally:
        measuring.shutdown(cancel_futures=True)  # whose files may be deleted after this
    return Run(finished, loaded.folder)


def _ego(agent: str) -> dict[str, str]:
    """The entry of a suite for an installed agent or the path of a network.

    Raises:
        InputError: There is no such agent or file.
    """
    path = Path(agent)
    if path.suffix != ".onnx":
        return {"agent": find(AGENTS, agent).name, "label": agent}
    if not path.is_file():
        raise InputError(f"{agent}: no such file")
    return {"agent": str(absolute(path)), "label": path.stem}


def _measure(suite: Suite, rows: CellRows) -> "MeasuredCell":
    from charms_bench.report.run_files import measure  # takes a while, so not before the workers

    return measure(suite, rows)
