"""Runs a suite: cells into shards, shards over workers, rows into the run folder."""

import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from charms_bench import __version__
from charms_bench.agent import Agent, Policy
from charms_bench.engine import EngineName
from charms_bench.errors import RunFolderError, SuiteError
from charms_bench.registry import AGENTS, TRAFFIC, find, plugins
from charms_bench.report.realism import TrafficCounts
from charms_bench.report.tables import CellRows
from charms_bench.results import RunFolder, Shard
from charms_bench.suite import EVALUATION_SEEDS, AgentSpec, Cell, Suite

SHARD_EPISODES: dict[EngineName, int] = {"batched": 150, "highway-env": 10}
"""Enough scenes for the compiled engine to be fast; few enough to lose little by a kill."""
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS")

Progress = Callable[[Cell, int], None]
"""Told of every finished shard: its cell and its number of episodes."""


@dataclass(frozen=True)
class Run:
    """A suite that has been run: its shards, in the folder."""

    suite: Suite
    folder: RunFolder
    shards: tuple[Shard, ...]

    def cells(self) -> list[CellRows]:
        """The rows of every cell, as tables want them."""
        return [
            CellRows(
                agent=cell.ego.title,
                traffic=cell.traffic.title,
                episodes=self.folder.read("episodes", shards),
                steps=self.folder.read("steps", shards),
                paper=cell.paper,
            )
            for cell, shards in self._cells()
        ]

    def following(self) -> list[TrafficCounts]:
        """What the vehicles of every cell did while they followed, as realism wants it."""
        return [
            TrafficCounts.of(
                cell.traffic.title,
                self.folder.read("episodes", shards),
                self.folder.read("counts", shards),
            )
            for cell, shards in self._cells()
        ]

    def _cells(self) -> Iterator[tuple[Cell, list[Shard]]]:
        for index, cell in enumerate(self.suite.cells):
            yield cell, [shard for shard in self.shards if shard.cell == index]


def open_run(path: Path) -> Run:
    """A finished run, from its folder alone.

    Raises:
        RunFolderError: It holds no run, one that is not finished, or one that is damaged.
    """
    folder = RunFolder(path)
    suite = folder.suite()
    shards = folder.shards()
    for index, cell in enumerate(suite.cells):
        there = sum(shard.episodes for shard in shards if shard.cell == index)
        if there != suite.episodes:
            raise RunFolderError(
                f"{path}: holds {there:,} of {suite.episodes:,} episodes of {cell.ego.title} in "
                f"{cell.traffic.title}; go on with `charms-bench run`"
            )
    return Run(suite, folder, shards)


def plan(suite: Suite, engine: EngineName) -> tuple[tuple[Shard, ...], dict[str, Any]]:
    """The shards of a suite, and what is to be known of the agents that take part."""
    if suite.seed + suite.episodes > EVALUATION_SEEDS:
        raise SuiteError(
            f"suite '{suite.suite}': the seeds {suite.seed} to {suite.seed + suite.episodes} "
            f"reach those of trainings, which start at {EVALUATION_SEEDS}"
        )
    agents: dict[str, Any] = {}
    shards = []
    for index, cell in enumerate(suite.cells):
        identities = _identities(cell, suite.folder)
        agents |= identities
        inputs = {
            "version": __version__,
            "engine": engine,
            "scene": suite.scene.model_dump(mode="json"),
            "ego": cell.ego.agent.key,
            "traffic": cell.traffic.traffic.model_dump(mode="json"),
            "agents": identities,
        }
        size = SHARD_EPISODES[engine]
        for start in range(0, suite.episodes, size):
            shard = {
                "first_seed": suite.seed + start,
                "episodes": min(size, suite.episodes - start),
            }
            key = hashlib.sha256(json.dumps([inputs, shard], sort_keys=True).encode())
            shards.append(Shard(cell=index, key=key.hexdigest(), **shard))
    return tuple(shards), agents


def run(
    suite: Suite,
    output: Path,
    engine: EngineName = "batched",
    workers: int | None = None,
    progress: Progress = lambda cell, episodes: None,
    rows: Path | None = None,
) -> Run:
    """Runs what is missing of a suite in the folder `output`.

    Args:
        suite: What to run.
        output: The run folder; a run that was interrupted there goes on.
        engine: `batched` or `highway-env`.
        workers: Processes; by default one a core.
        progress: Told of every shard, those that were there first.
        rows: Another run's folder, whose finished shards are taken where they are the same.

    Raises:
        CharmsBenchError: As soon as something is wrong; finished shards are kept.
    """
    folder = RunFolder(output)
    folder.open_for(suite, engine)
    shards, agents = plan(suite, engine)
    folder.write_manifest(suite, engine, agents)
    if rows is not None:
        folder.take(shards, rows)
    missing = []
    for shard in shards:
        if folder.has(shard):
            progress(suite.cells[shard.cell], shard.episodes)
        else:
            missing.append(shard)
    if missing:
        with local_workers(min(workers or os.cpu_count() or 1, len(missing)), engine) as executor:
            _run_shards(executor, suite, folder, missing, engine, progress)
    folder.drop_others(shards)
    return Run(suite, folder, shards)


def local_workers(count: int, engine: EngineName) -> ProcessPoolExecutor:
    """Worker processes of one thread each, started afresh."""
    os.environ |= dict.fromkeys(_THREADS, "1")
    if engine == "highway-env":
        use_exact_maths()
    return ProcessPoolExecutor(
        count, mp_context=multiprocessing.get_context("spawn"), initializer=start_worker
    )


def use_exact_maths() -> None:
    """Has NumPy in processes started from now on take its functions from the C library.

    Its vectorised tan, arcsin, arctan, exp and power differ from the C library's in the last bit,
    and so would highway-env's vehicles from the compiled ones.
    """
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]
    os.environ["NPY_DISABLE_CPU_FEATURES"] = " ".join(extensions.get("found", ()))


def run_shard(suite: Suite, shard: Shard, engine: EngineName, output: Path) -> Shard:
    """Simulates one shard and writes its rows; a pure function of what its key names."""
    from charms_bench.recording import Recording
    from charms_bench.simulation import Simulation

    cell = suite.cells[shard.cell]
    ego = cell.ego.agent
    traffic = cell.traffic.traffic.make()
    agents = {name: _agent(AgentSpec(name=name), suite.folder) for name in traffic.agents}
    agents[ego.key] = _agent(ego, suite.folder)
    simulation = Simulation(suite.scene, shard.episodes, ego.key, traffic, agents, engine)
    first = shard.first_seed
    simulation.reset(np.arange(first, first + shard.episodes, dtype=np.uint64))
    recording = Recording(simulation)
    while simulation.scene.active.any():
        simulation.step()
        recording.note()
    rows = {
        "steps": recording.steps(),
        "counts": recording.counts(),
        "episodes": recording.episodes(),
    }
    RunFolder(output).write(shard, rows)
    return shard


def _run_shards(
    executor: Executor,
    suite: Suite,
    folder: RunFolder,
    shards: list[Shard],
    engine: EngineName,
    progress: Progress,
) -> None:
    futures = [executor.submit(run_shard, suite, shard, engine, folder.path) for shard in shards]
    try:
        for future in as_completed(futures):
            shard = future.result()
            progress(suite.cells[shard.cell], shard.episodes)
    except BrokenProcessPool as error:
        raise RunFolderError(
            f"a worker process died; finished shards are in {folder.path}, "
            "and the same command goes on from there"
        ) from error
    finally:
        executor.shutdown(cancel_futures=True)


def _identities(cell: Cell, folder: Path) -> dict[str, Any]:
    """What tells each agent of a cell from any other version of it."""
    traffic = cell.traffic.traffic
    specs = [cell.ego.agent, *(AgentSpec(name=name) for name in traffic.make().agents)]
    identities = {spec.key: _identity(spec, folder) for spec in specs}
    installed = plugins(TRAFFIC)
    if traffic.name in installed:
        plugin = installed[traffic.name]
        identities[f"traffic {traffic.name}"] = {
            "distribution": plugin.distribution,
            "version": plugin.version,
        }
    return identities


def _identity(spec: AgentSpec, folder: Path) -> dict[str, str]:
    agent = _agent(spec, folder)
    identity = {"weights_sha256": agent.weights_sha256} if isinstance(agent, Policy) else {}
    if spec.name is not None:
        plugin = find(AGENTS, spec.name)
        identity |= {"distribution": plugin.distribution, "version": plugin.version}
    return identity


def _agent(spec: AgentSpec, folder: Path) -> Agent:
    return _made(spec.model_dump_json(), folder)


@lru_cache
def _made(spec: str, folder: Path) -> Agent:
    """An agent is made once a process."""
    return AgentSpec.model_validate_json(spec).make(folder)


def start_worker() -> None:
    """Leaves Ctrl-C to the parent, and ends the worker when the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
